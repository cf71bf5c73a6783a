"""What goes on, shown on standard error: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from difffric.commands.running.durations import (
    keep_durations,
    name_work,
    read_compile_times,
    read_course,
)
from difffric.commands.running.remaining_time import (
    RemainingTime,
    format_duration,
    format_remaining,
)
from difffric.compute.programs.record import RECORDS, UNDER_WAY
from difffric.name_text import make_printable

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

_FIRST, _NEXT = 15.0, 30.0
"""When [s] the first line comes where there is no terminal, and those after it: a log is not to be
filled, and who waits is to see that something goes on."""
_BAR = 24
"""Characters of the bar."""
_SOON = 1.0
"""A program is told of when it has been compiled for so long [s]: most are done sooner."""

_PROGRAMS = {
    "estimation.extended_model": "the rig with every effect",
    "estimation.following.compiled_search": "the fit of pushes",
    "calibration.batched_answers": "the fit from many starts",
    "identification.compiled_models": "the inversion for mu_s",
    "identification.tabulated_model": "the controller's table",
    "centering.landing": "where a part lands",
    "simulation.families": "the curve families",
    "simulation.observables": "a push",
    "simulation.trajectory": "a push over time",
    "simulation.sensitivities": "a push's derivatives",
    "monitoring.change_cause": "what a change may come from",
}
"""What the programs of a module are for, as one tells it."""


class ProgressDisplay:
    """Shows a piece of work from its beginning to its end, unless `quiet`; use it in `with`.

    `words` are those of the command line, by which the time that remains is estimated.
    """

    def __init__(self, words: Sequence[str], quiet: bool, console: Console):
        self._work, self._console, self._quiet = name_work(words), console, quiet
        self._what, self._share, self._compiled = "starting", 0.0, bool(UNDER_WAY)
        self._known_times = read_compile_times()
        self._first_record = len(RECORDS)
        self._began = time.perf_counter()
        self._remaining = RemainingTime(read_course(self._work, self._compiled))
        self._over = Event()
        self._stack = ExitStack()

    def __enter__(self) -> ProgressDisplay:
        if not self._quiet:
            self._stack.enter_context(self._show())
        return self

    def __exit__(self, kind: Any, *error: Any) -> None:
        self._stack.__exit__(kind, *error)
        if kind is None:
            made = {one.name: one.traced + one.compiled for one in RECORDS[self._first_record :]}
            made = {name: seconds for name, seconds in made.items() if seconds >= _SOON}
            course = self._remaining.end(self._elapsed)
            keep_durations(self._work, self._compiled or bool(made), course, made)

    def tell(self, what: str, share: float) -> None:
        """Show what is being done from now on, and the share of the whole that is done."""
        self._what, self._share = make_printable(what), max(self._share, min(share, 1.0))
        self._remaining.tell(share, self._elapsed)

    @property
    def _elapsed(self) -> float:
        return time.perf_counter() - self._began

    def describe(self) -> tuple[str, str]:
        """Return what is being done, and how long it has taken and will take yet."""
        compiling = self._describe_programs()
        elapsed = self._elapsed
        remaining = self._remaining.estimate(elapsed)
        left = "" if remaining is None else f", {format_remaining(remaining)}"
        times = f"{format_duration(elapsed)} so far{left}"
        return f"{self._what}; compiling {compiling}" if compiling else self._what, times

    def _describe_programs(self) -> str:
        """Name the program that is compiled for the longest by now, and how long it takes."""
        now = time.perf_counter()
        under_way = [one for one in UNDER_WAY.copy() if now - one[1] > _SOON]
        if not under_way:
            return ""
        if not self._compiled:  # what was known is of work that compiled nothing
            self._compiled = True
            self._remaining.before = read_course(self._work, True)
        record, since = min(under_way, key=lambda one: one[1])
        taken, last = now - since, self._known_times.get(record.name)
        took = "" if last is None else f", {format_duration(last)} the last time"
        return f"{_name_program(record.name)} ({format_duration(taken)}{took})"

    def _show(self) -> Any:
        if self._console.is_terminal:
            # Here, as a command's help shows no bar and would wait for its import.
            from rich.live import Live

            return Live(
                get_renderable=self._render,
                console=self._console,
                transient=True,
                refresh_per_second=4,
                # What is printed goes to where it belongs, also where that is a file.
                redirect_stdout=sys.stdout.isatty(),
            )
        self._stack.callback(self._over.set)
        Thread(target=self._print_lines, daemon=True).start()
        return ExitStack()

    def _render(self) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        what, times = self.describe()
        full = round(_BAR * self._share)
        bar = Text("━" * full, style="green")
        bar.append("━" * (_BAR - full), style="bright_black")
        bar.append(f" {100 * self._share:3.0f} %  {times}", style="default")
        lines = (Text(what, no_wrap=True, overflow="ellipsis"), bar)
        bar.no_wrap = True
        return Group(*lines)

    def _print_lines(self) -> None:
        wait = _FIRST
        while not self._over.wait(wait):
            what, times = self.describe()
            line = f"difffric: {what}: {100 * self._share:.0f} %, {times}"
            self._console.print(line, soft_wrap=True)
            wait = _NEXT


def _name_program(name: str) -> str:
    """Say what a program is for, by the name of its function."""
    module, _, function = name.removeprefix("difffric.").rpartition(".")
    return _PROGRAMS.get(module, function.strip("_").replace("_", " "))
