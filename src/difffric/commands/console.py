"""What every command shows a person: its progress, its tables, and the folder that it wrote."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from difffric.commands import reports
from difffric.commands.layout.json_output import is_json_asked
from difffric.commands.layout.terminal_tables import lay_out
from difffric.commands.running.interruption import COMMAND, name_partial
from difffric.commands.running.progress_display import ProgressDisplay
from difffric.errors import InputError
from difffric.name_text import make_printable
from difffric.output_folder import check_writable
from difffric.progress import Tell
from difffric.timings import Timings, keep_timings

if TYPE_CHECKING:
    from difffric.commands.reports.page import Report


def open_console(*, stderr: bool = False) -> Console:
    """Return a console that shows texts as they are: names from users' files may look like markup
    or like the code of an emoji."""
    return Console(stderr=stderr, highlight=False, markup=False, emoji=False)


class ShownProgress:
    """Tells a display how far the work is, and the work's timings which part of it goes on."""

    def __init__(self, show: Tell, timings: Timings):
        self._show, self.timings = show, timings

    def __call__(self, what: str, share: float, /) -> None:
        """Tell what is being done, and the share of the whole that is done."""
        self.timings.begin(what)
        self._show(what, share)


@contextmanager
def show_progress(quiet: bool) -> Iterator[ShownProgress]:
    """Yield `tell(what, share done)`, which shows on standard error what goes on, unless quiet;
    keep the timings of what is done within, and what is known of it by then, for Ctrl-C."""
    display = ProgressDisplay(sys.argv[1:], quiet, open_console(stderr=True))
    with keep_timings() as timings, COMMAND.keep_known(), display:

        def show(what: str, share: float) -> None:
            COMMAND.now = what
            display.tell(what, share)

        yield ShownProgress(show, timings)
        COMMAND.now = ""


def check_out(out: Path | None) -> None:
    """Raise `InputError` where `--out` cannot be written, before the work and not after it."""
    if out is not None:
        check_writable(out)
        COMMAND.out = out


def check_setup_stays(out: Path | None, setup: Path) -> None:
    """Raise `InputError` where the set-up that is written would replace the one that is read."""
    own = None if out is None else out / "setup.toml"
    if own is not None and own.exists() and setup.exists() and own.samefile(setup):
        raise InputError(
            f"--out {out}: its setup.toml is the set-up that the fit starts from, and would be "
            "replaced by the fitted one; give another folder"
        )


def print_and_write(
    report: Report,
    answer: Any,
    out: Path | None,
    files: Mapping[str, bytes] | None = None,
    timings: Timings | None = None,
    notes: Sequence[str] = (),
) -> None:
    """Print the report's summary and tables, write the folder where one was asked for, and print
    what to do next.

    `notes`: what was converted as the data were read; they stand after the verdict, and in
    result.json. `files` are written beside result.json, report.html and the figures; `timings`,
    where there are any, stand in result.json. With `--json` what result.json holds is printed, and
    nothing else.
    """
    if notes:
        told = [f"Data: {note}." for note in dict.fromkeys(notes)]
        report = replace(report, summary=[*told, *report.summary])
        answer = {**answer, "data_notes": [*dict.fromkeys(notes)]}
    if timings is not None:
        answer = {**answer, "timings": timings.as_dict()}
    if is_json_asked():
        sys.stdout.write(reports.page.format_answer(answer))
        sys.stdout.flush()
    else:
        _print_report(report)
    if out is not None:
        reports.page.write_folder(out, answer, report, files)
        with suppress(OSError):  # what was known when an earlier run was stopped
            name_partial(out).unlink(missing_ok=True)
        names = ", ".join(["result.json", "report.html", *(files or {}), "figures"])
        if not is_json_asked():
            open_console().print(f"written to {out}: {names}")
    if not is_json_asked():
        _print_advice(report)


def _print_report(report: Report) -> None:
    """Print what a report found, within the terminal's width."""
    console = open_console()
    for line in report.summary:
        console.print(make_printable(line))
    for section in report.sections:
        for table in section.tables:
            for shown in lay_out(table.caption, table.columns, table.rows, console.width):
                console.print(shown)


def _print_advice(report: Report) -> None:
    """Print what to do next, and the command for it in one line that can be copied."""
    console = open_console()
    for line in report.advice:
        console.print(f"Next: {make_printable(line)}")
    if report.command:
        console.print(f"  {make_printable(report.command)}", soft_wrap=True)
