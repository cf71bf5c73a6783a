"""Where a fleet's tasks run: in this process, in several, or on a cluster (dask.distributed)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from difffric.errors import InputError

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "POLARS_MAX_THREADS": "1",
    "NPROC": "1",  # XLA's thread pool
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "1e9",  # a kill would leave it half-written
}
"""A worker's surroundings: as many workers as cores, each on one of them. JAX's cache it only
reads."""
_LIVES = 10
"""How often a task may lose its worker before it is taken to be the one that kills it."""

PATIENCE = 30
"""How long a scheduler may take to answer [s]."""


class Lost(Exception):
    """A task whose worker died, again and again."""


class Runner(Protocol):
    """Runs tasks; yields (task, what `function` made of it or the exception `Lost`), in the order
    in which they end."""

    def __call__(self, function: Callable, tasks: Iterable) -> Iterator[tuple[Any, Any]]: ...


@contextmanager
def workers(n: int = 1, scheduler: str | None = None) -> Iterator[Runner]:
    """A runner: of this process for one worker, of n new ones, or of a scheduler's own.

    New processes are spawned: a fork would copy the locks of this one's threads. They end with it,
    also where it is killed. A script that asks for them needs `if __name__ == "__main__":`.

    Raises `InputError` without dask.distributed, and for a scheduler that does not answer.
    """
    if scheduler is None and n == 1:
        yield _here
        return
    try:
        import dask.config
        import distributed
    except ImportError:
        raise InputError(
            "several workers or a scheduler need dask.distributed: "
            "pip install 'difffric[fleet]', or --workers 1"
        ) from None
    dask.config.set({"distributed.worker.multiprocessing-method": "spawn"})
    dask.config.set({"distributed.scheduler.allowed-failures": _LIVES})
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"})
    dask.config.set({"logging.distributed": "critical"})
    cluster = None
    try:
        if scheduler is None:
            local: Any = distributed.LocalCluster
            cluster = local(
                n_workers=n, threads_per_worker=1, processes=True, dashboard_address=None,
                memory_limit=0, env={**_own(), **ONE_THREAD}, silence_logs=50,
            )  # fmt: skip
        client = distributed.Client(cluster or scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        words = " ".join(str(error).split())
        raise InputError(f"{scheduler or 'workers'}: no scheduler answers: {words}") from None
    try:
        yield lambda function, tasks: _there(client, function, tasks)
    finally:
        client.close()
        if cluster is not None:
            cluster.close()


def _own() -> dict[str, str]:
    """What the command line has set for JAX."""
    names = ("JAX_", "EQX_", "DIFFFRIC_")
    return {name: x for name, x in os.environ.items() if name.startswith(names)}


def _here(function: Callable, tasks: Iterable) -> Iterator[tuple[Any, Any]]:
    for task in tasks:
        yield task, function(task)


def _there(client, function: Callable, tasks: Iterable) -> Iterator[tuple[Any, Any]]:
    """As tasks end; a few more are under way than there are workers, so that none waits and the
    tasks need not all be in memory."""
    import distributed

    rest, of = iter(tasks), {}
    done = distributed.as_completed(loop=client.loop)

    def add() -> None:
        for task in rest:
            future = client.submit(function, task, pure=False)
            of[future.key] = task
            done.add(future)
            return

    for _ in range(2 * max(1, len(client.nthreads())) + 2):
        add()
    for future in done:
        try:
            result = future.result()
        except distributed.KilledWorker as error:
            result = Lost(str(error))
        task = of.pop(future.key)
        future.release()
        add()
        yield task, result
