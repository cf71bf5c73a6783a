"""The work of the commands at its smallest, on pushes simulated with a set-up: what it compiles,
later commands find.

A program is made for a kind of rig, a kind of data and a padded number of pushes and samples, so
that measured pushes of that kind need no other. Several processes share the work, as XLA compiles
on one core; the store keeps them from making the same (`compute.programs`).
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from signal import SIG_IGN, SIGINT, signal

import numpy as np

import difffric as df
from difffric.compute.programs import record
from difffric.compute.programs.private_folder import FOLDER
from difffric.compute.programs.record import Record
from difffric.compute.programs.store import find_folder
from difffric.cores import count_cores
from difffric.errors import DifffricError, InputError
from difffric.known_so_far import KEPT_ON_DISK, tell_known
from difffric.progress import Tell, silent
from difffric.rig import parameters
from difffric.rig.setup import Setup
from difffric.units import from_mm_min

_SPEEDS = tuple(from_mm_min(np.linspace(500.0, 5000.0, 12)))
"""As many pushes as one meets, at speeds [m/s] that most rigs reach."""
_BEFORE, _AFTER = 0.03, 0.1
"""Seconds recorded before a push and after its rest."""
_SCATTER = 0.02
"""Relative scatter of mu_s of the simulated pushes, where the set-up says none."""
_NOISE = (0.5, 0.3e-6)
"""Noise [N], [m] of what is simulated, where the set-up says none."""
_LIST = "made-"
"""How the files begin that say what was made for a set-up."""


def make_table(setup: Setup) -> df.Pushes:
    """Pushes of a set-up's rig over the speeds, with scatter and noise."""
    random = np.random.default_rng(0)
    mu = float(parameters.values(setup.rig)["mu_s"])
    mu = mu * np.exp((setup.mu_s_scatter or _SCATTER) * random.standard_normal(len(_SPEEDS)))
    seen = [
        df.observe(parameters.with_values(setup.rig, {"mu_s": m}), v)
        for m, v in zip(mu, _SPEEDS, strict=True)
    ]
    force, distance = (
        np.array([float(getattr(x, name)) for x in seen])
        for name in ("peak_force", "sliding_distance")
    )
    force, distance = (x * (1 + 1e-3 * random.standard_normal(len(x))) for x in (force, distance))
    return df.Pushes(np.array(_SPEEDS), force, distance)


def make_recordings(setup: Setup) -> df.Recordings:
    """Recordings of the same, at the rate of the set-up's force sensor."""
    random, rig = np.random.default_rng(0), setup.rig
    mean, dt = float(parameters.values(rig)["mu_s"]), 1.0 / float(rig.force_sensor.rate)
    said = (rig.force_sensor.noise, rig.probe.noise)
    levels = [n if s is None else float(s) for s, n in zip(said, _NOISE, strict=True)]
    made = []
    for v in _SPEEDS:
        mu = mean * float(np.exp((setup.mu_s_scatter or _SCATTER) * random.standard_normal()))
        push = df.simulate(rig, v, mu_s=mu)
        if push.reason is not None:
            continue
        t = np.arange(-_BEFORE, float(push.stop_time) + _AFTER, dt)
        force, position = (
            df.measurements.Channel.of(
                np.asarray(x) + level * random.standard_normal(len(t)), dt, -_BEFORE, unit
            )
            for x, level, unit in zip(push.evaluate(t)[:2], levels, ("N", "m"), strict=True)
        )
        made.append(df.Recording(v, force, position))
    return df.Recordings(tuple(made))


def _use_recordings(setup: Setup) -> None:
    df.identify(setup, make_recordings(setup))
    df.fit(setup, make_recordings(setup))


def _use_table(setup: Setup) -> None:
    df.fit(setup, make_table(setup))
    df.identify(setup, make_table(setup))


TASKS: dict[str, Callable[[Setup], object]] = {
    "diagnosing recordings": lambda setup: df.diagnose(setup, make_recordings(setup)),
    "diagnosing a table": lambda setup: df.diagnose(setup, make_table(setup)),
    "fitting and identifying recordings": _use_recordings,
    "fitting and identifying a table": _use_table,
    "planning a push": lambda setup: df.plan(df.centering.Known.of(setup), 5e-4, 0.0),
    "simulating a push": lambda setup: df.simulate(setup.rig, _SPEEDS[5]).evaluate(np.zeros(2)),
}
"""What is done with each set-up, the longest first."""


def _run_task(name: str, setup: Setup) -> tuple[str, list[Record]]:
    """What kept a task from its end, if anything, and the programs that this process used so far:
    a task asks only for those that it does not find in the process."""
    why = ""
    try:
        TASKS[name](setup)
    except DifffricError as error:  # a rig that no such push fits has no such program
        why = str(error).splitlines()[0]
    return why, record.RECORDS


def make_programs(
    setups: Sequence[Setup], processes: int | None = None, tell: Tell = silent
) -> Iterator[tuple[str, str, list[Record]]]:
    """Have the programs made that the commands need for these set-ups. Yields, as each task ends,
    what it was, what kept it from its end, and the programs that its process used; nothing, where
    all that was made once is still there.

    Raises `InputError` where no programs are kept.
    """
    folder = find_folder(os.environ.get(FOLDER, ""))
    if folder is None:
        raise InputError(f"no programs are kept: {FOLDER} names no folder that is this user's")
    missing = [setup for setup in setups if not _is_complete(_find_list(folder, setup))]
    work = [(name, setup) for name in TASKS for setup in missing]
    if not work:
        return
    done: dict[int, dict[str, Record]] = {id(setup): {} for setup in missing}
    count = min(processes or count_cores(), len(work))
    # Ctrl-C reaches them, too: who started them kills them.
    quiet = {"initializer": signal, "initargs": (SIGINT, SIG_IGN)}
    with ProcessPoolExecutor(count, mp_context=get_context("spawn"), **quiet) as pool:
        running = {pool.submit(_run_task, *task): task for task in work}
        for k, future in enumerate(as_completed(running)):
            name, setup = running[future]
            why, used = future.result()
            done[id(setup)] |= {one.key: one for one in used}
            tell(name, (k + 1) / len(work))
            tell_known(KEPT_ON_DISK, f"what {k + 1} of {len(work)} tasks had compiled")
            yield name, why, used
    for setup in missing:
        lines = json.dumps([asdict(one) for one in done[id(setup)].values()])
        _find_list(folder, setup).write_text(lines, encoding="utf-8")


def list_made(setups: Sequence[Setup]) -> list[Record]:
    """The programs that were made for these set-ups, each once, as they were made."""
    folder = find_folder(os.environ.get(FOLDER, ""))
    found: dict[str, Record] = {}
    for path in [] if folder is None else [_find_list(folder, setup) for setup in setups]:
        if path.exists():
            lines = json.loads(path.read_text(encoding="utf-8"))
            found |= {line["key"]: Record(**line) for line in lines}
    return list(found.values())


def _find_list(folder: Path, setup: Setup) -> Path:
    """The file that says what was made for a set-up."""
    said = repr((setup.rig, setup.mu_s_scatter, sorted(setup.extras.items()), sorted(TASKS)))
    return folder / f"{_LIST}{sha256(said.encode()).hexdigest()[:16]}.json"


def _is_complete(made: Path) -> bool:
    """Whether all that a file says was made is still kept."""
    try:
        keys = [line["key"] for line in json.loads(made.read_text(encoding="utf-8"))]
    except (OSError, ValueError):
        return False
    return all(any(made.parent.glob(f"{key}*")) for key in keys)
