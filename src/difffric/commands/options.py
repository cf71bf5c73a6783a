"""What the commands share: their options, progress, tables for a person, the folder they write."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Differentiable identification of sliding friction.",
)

Setup = Annotated[Path, typer.Argument(help="the rig, a setup.toml", show_default=False)]
Data = Annotated[Path, typer.Argument(help="measured pushes, .csv or .tdms", show_default=False)]
SetupOption = Annotated[
    Path, typer.Option("--setup", help="the rig, a setup.toml", show_default=False)
]
DataMass = Annotated[
    bool, typer.Option("--use-data-mass", help="masses may contradict the set-up's")
]
SkipBad = Annotated[bool, typer.Option("--skip-bad", help="leave out what cannot be used")]
Out = Annotated[Path | None, typer.Option(help="folder for result.json, report.html, figures")]
Quiet = Annotated[bool, typer.Option("--quiet", help="no progress on standard error")]

_WIDEST = 200
"""Characters of a printed table."""


def positive(name: str, value: float | None) -> float | None:
    """An option's value, which must be a number > 0."""
    from difffric.errors import InputError

    if value is not None and not 0 < value < float("inf"):
        raise InputError(f"{name}: expected a number > 0, got {value:g}")
    return value


def rig_of(setup: Path, mu_s=None, mass_kg=None, stroke_mm=None):
    """The set-up's rig with what the command line overrides."""
    from difffric.rig import parameters
    from difffric.rig.setup_toml import load_setup
    from difffric.units import from_mm

    rig = load_setup(setup)
    given = {"mu_s": positive("--mu-s", mu_s), "mass_kg": positive("--mass-kg", mass_kg)}
    rig = parameters.with_values(rig, {k: v for k, v in given.items() if v is not None})
    if positive("--stroke-mm", stroke_mm) is not None:
        rig = parameters.with_stroke(rig, from_mm(stroke_mm))
    return rig


@contextmanager
def progress(quiet: bool):
    """Yields `tell(what, share done)`, shown on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=quiet) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda what, share: bar.update(task, description=what, completed=share)


def finish(report, answer, out: Path | None, files: Mapping[str, bytes] | None = None) -> None:
    """Print the report's tables for a person; write the folder where one was asked for, with
    other files if there are any."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False, markup=False)
    own_width = console.width
    for line in report.summary:
        console.print(line)
    for section in report.sections:
        for table in section.tables:
            shown = Table(
                title=table.caption, title_justify="left", title_style="bold", box=SIMPLE_HEAD,
                padding=0, pad_edge=False, collapse_padding=True,
            )  # fmt: skip
            for i, column in enumerate(table.columns):
                shown.add_column(
                    Text(column), justify="left" if i == 0 else "right", overflow="fold"
                )
            for row in table.rows:
                shown.add_row(*(Text(cell) for cell in row))
            # Numbers are not to be broken where a terminal is narrow: it wraps whole lines.
            needed = console.measure(shown, options=console.options.update(width=_WIDEST)).maximum
            console.width = max(own_width, needed)
            console.print(shown)
    console.width = own_width
    if out is not None:
        from difffric.commands.reports.page import write

        write(out, answer, report, files)
        names = ", ".join(["result.json", "report.html", *(files or {}), "figures"])
        console.print(f"written to {out}: {names}")


def check_writable(out: Path | None) -> None:
    """Say that a folder cannot be written before the work, not after it; nothing is made yet."""
    if out is not None:
        from difffric.output_folder import check_writable

        check_writable(out)
