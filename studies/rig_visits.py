"""Count how often the way of a command leaves a room and comes back with the rig in its hands.

    python -m studies.rig_visits [EXAMPLES]

A *stay* is a run of consecutive calls, in one module, of functions that are given a `Rig` (as an
argument, or as `self`). Rooms are the modules stayed in; a *return* is a stay in a room that was
left before. Few returns mean that data flow through the rooms and do not commute between them.
A place in the source that calls counts once, when it is first passed: a loop is no longer way to a
reader. Calls that JAX traces count, as a reader follows them too.

It runs on any version of the source: put its `src` first on PYTHONPATH.
"""

from __future__ import annotations

import inspect
import sys
from collections import Counter
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any

import jax

import difffric as df

PACKAGE = str(Path(df.__path__[0]))


def trace_rooms(work: Callable[[], Any]) -> list[str]:
    """The module of every call during `work` of a function of the package that is given a rig."""
    rooms: list[str] = []
    seen: set[tuple[Any, int, Any]] = set()

    def note(frame, event, _) -> None:
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(PACKAGE):
            return
        if code.co_name.startswith("<"):  # lambdas and comprehensions are part of their function
            return
        count = code.co_argcount + code.co_kwonlyargcount
        given = [frame.f_locals.get(name) for name in code.co_varnames[:count]]
        if code.co_flags & inspect.CO_VARARGS:
            given += frame.f_locals[code.co_varnames[count]]
        caller = frame.f_back
        site = (caller and caller.f_code, caller.f_lineno if caller else 0, code)
        if site not in seen and any(isinstance(x, df.Rig) for x in given):
            seen.add(site)
            rooms.append(frame.f_globals["__name__"].removeprefix("difffric."))

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return rooms


def count_stays(rooms: list[str]) -> list[tuple[str, int]]:
    """(room, calls) of each run of consecutive calls in one room."""
    return [(room, len(list(calls))) for room, calls in groupby(rooms)]


def tell(name: str, work: Callable[[], Any]) -> None:
    """Print the stays, rooms and returns of some work, the rooms stayed in most often first."""
    stays = Counter(room for room, _ in count_stays(trace_rooms(work)))
    total = sum(stays.values())
    visits = sum(n for room, n in stays.items() if room.split(".")[-1] == "parameters")
    print(f"{name}: {total} stays in {len(stays)} rooms, {total - len(stays)} returns,")
    print(f"    {visits} visits to the table of parameters")
    for room, n in stays.most_common():
        print(f"    {n:4d} {room}")


def main() -> None:
    """Count for `simulate` and for `identify` of a table."""
    jax.config.update("jax_enable_x64", True)
    root = Path(__file__).parents[1] / "examples"
    examples = Path(sys.argv[1]) if len(sys.argv) > 1 else root
    rig = df.load_setup(examples / "setup.toml")
    pushes = df.load(examples / "pushes.csv")
    tell("simulate", lambda: df.simulate(rig, 0.05))
    tell("identify", lambda: df.identify(rig, pushes))
    tell("identify, its programs compiled", lambda: df.identify(rig, pushes))


if __name__ == "__main__":
    main()
