"""Where a fleet's tasks run: in this process, in several, or on a cluster (dask.distributed)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import chain
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
"""Environment of a worker: there are as many workers as cores, so each keeps to one thread. It
reads JAX's cache of compiled programs and does not write it."""
ALLOWED_FAILURES = 10
"""Dask's `allowed-failures`: a task that has lost its worker this often is taken to be what kills
it. More than dask's own 3, as workers are also killed for reasons that are not the task's."""
PATIENCE = 30
"""How long a scheduler may take to answer [s]: enough for one that is just being started."""


class Lost(Exception):
    """Stands for the answer of a task whose worker died each time, again and again."""


class Runner(Protocol):
    """Runs tasks. Yields each task with what `function` returned for it, or with a `Lost`, in the
    order in which they end."""

    def __call__(self, function: Callable, tasks: Iterable) -> Iterator[tuple[Any, Any]]: ...


@contextmanager
def start_workers(n: int = 1, scheduler: str | None = None) -> Iterator[Runner]:
    """Yield a runner: in this process for n = 1, on n new processes, or on the workers of a dask
    `scheduler` (its address).

    New processes are spawned, as a fork would copy the locks of this one's threads, and only with
    the first task, as they take seconds to start. They end with this process, also where it is
    killed. A script that asks for them needs `if __name__ == "__main__":`.

    Raises `InputError` without dask.distributed, and for a scheduler that does not answer.
    """
    if scheduler is None and n == 1:
        yield _run_here
        return
    try:
        import dask.config
        import distributed  # noqa: F401
    except ImportError:
        raise InputError(
            "several workers or a scheduler need dask.distributed: "
            "pip install 'difffric[fleet]', or --workers 1"
        ) from None
    dask.config.set({"distributed.worker.multiprocessing-method": "spawn"})
    dask.config.set({"distributed.scheduler.allowed-failures": ALLOWED_FAILURES})
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"})
    dask.config.set({"logging.distributed": "critical"})
    # It would stop the work a hundred times a second to note where it is.
    dask.config.set({"distributed.worker.profile.enabled": False})
    with ExitStack() as stack:
        clients = [] if scheduler is None else [stack.enter_context(_connect(n, scheduler))]

        def run(function: Callable, tasks: Iterable) -> Iterator[tuple[Any, Any]]:
            rest = iter(tasks)
            for first in rest:
                if not clients:
                    clients.append(stack.enter_context(_connect(n, scheduler)))
                yield from _run_on(clients[0], function, chain([first], rest))

        yield run


@contextmanager
def _connect(n: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a dask client of a scheduler, or of n new processes where there is none.

    Raises `InputError` for a scheduler that does not answer.
    """
    import distributed  # an optional dependency

    cluster = None
    try:
        if scheduler is None:
            local: Any = distributed.LocalCluster
            cluster = local(
                n_workers=n,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                memory_limit=0,
                env={**_copy_settings(), **ONE_THREAD},
                silence_logs=50,
            )
        client = distributed.Client(cluster or scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        words = " ".join(str(error).split())
        raise InputError(f"{scheduler or 'workers'}: no scheduler answers: {words}") from None
    try:
        yield client
    finally:
        client.close()
        if cluster is not None:
            cluster.close()


def _copy_settings() -> dict[str, str]:
    """Return the environment variables by which the command line has set up JAX."""
    names = ("JAX_", "EQX_", "DIFFFRIC_")
    return {name: x for name, x in os.environ.items() if name.startswith(names)}


def _run_here(function: Callable, tasks: Iterable) -> Iterator[tuple[Any, Any]]:
    """The runner of this process: one task after the other."""
    for task in tasks:
        yield task, function(task)


def _run_on(client: Any, function: Callable, tasks: Iterable) -> Iterator[tuple[Any, Any]]:
    """The runner of a dask cluster. A few more tasks are under way than there are workers, so that
    none waits, and the tasks need not all be in memory."""
    import distributed  # an optional dependency

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
