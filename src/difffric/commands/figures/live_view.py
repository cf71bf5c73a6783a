"""Shows pushes while they come: a table that grows on a terminal, a line for each elsewhere, and a
figure where one is asked for."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from difffric.acquisition.push import Acquired
from difffric.commands.figures.acquire import draw_live
from difffric.identification.live import LivePush
from difffric.measurements.recordings import Recording
from difffric.name_text import make_printable
from difffric.number_text import format_number, format_pair
from difffric.units import to_mm_min, to_um

_COLUMNS = ("push", "mm/min", "samples")
_IDENTIFIED = ("F_p [N]", "d [µm]", "mu_s: force", "distance", "(7)", "optimal", "after [ms]")
_WAYS = ("mu_s_force", "mu_s_distance", "mu_s_weighted", "mu_s_optimal")
_WINDOWS = {"qtagg", "qt5agg", "tkagg", "gtk3agg", "gtk4agg", "wxagg", "macosx"}
"""matplotlib's backends that open a window."""


def list_notes(acquired: Acquired, found: LivePush | None) -> list[str]:
    """Return what is to be said of a push beside its numbers, a line for each thing."""
    said = acquired.troubles
    if found is not None:
        said += found.problems
        if found.reason and found.reason not in said:
            said.append(found.reason)
    return said


def list_cells(acquired: Acquired, found: LivePush | None) -> list[str]:
    """Return a push as a row of numbers, written out."""
    speed = format_number(to_mm_min(acquired.command.velocity), 6)
    row = [acquired.name, speed, str(acquired.samples)]
    if found is None:
        return row
    seen = found.reduced
    row.append(format_number(seen and seen.peak_force, 5))
    row.append(format_number(seen and to_um(seen.sliding_distance), 5))
    for way in _WAYS:
        one = found.friction and getattr(found.friction, way)
        value, error = format_pair(one.value, one.standard_error) if one else ("–", "–")
        row.append(value if error == "–" else f"{value} ± {error}")
    return [*row, format_number(1e3 * found.seconds, 3)]


class LiveView:
    """Shows pushes on standard error, unless `quiet`; with their mu_s where `identified`."""

    def __init__(self, *, identified: bool, quiet: bool, console: Console | None = None):
        self._quiet = quiet
        self._console = console or Console(stderr=True, highlight=False, markup=False, emoji=False)
        self._columns = (*_COLUMNS, *(_IDENTIFIED if identified else ()))
        self._rows: list[list[str]] = []
        self._now = ""
        self._live: Live | None = None

    def __enter__(self) -> LiveView:
        if not self._quiet and self._console.is_terminal:
            self._live = Live(self._table(), console=self._console, auto_refresh=False)
            self._live.__enter__()
        return self

    def __exit__(self, *what) -> None:
        if self._live:
            self._live.__exit__(*what)

    def tell(self, what: str, share: float) -> None:
        """Show what goes on now, below the table; on a terminal only."""
        if self._live:
            self._now = what
            self._live.update(self._table(), refresh=True)

    def add(self, acquired: Acquired, found: LivePush | None) -> None:
        """Add a push to the table, or print its line."""
        row = [make_printable(cell) for cell in list_cells(acquired, found)]
        said = make_printable("; ".join(list_notes(acquired, found)))
        if self._live:
            self._rows.append([*row, said])
            self._live.update(self._table(), refresh=True)
        elif not self._quiet:
            parts = [row[0], f"{row[1]} mm/min", f"{row[2]} samples"]
            for name, cell in zip(self._columns[3:], row[3:], strict=True):
                name, _, unit = name.rstrip("]").partition(" [")
                if cell != "–":
                    parts.append(f"{name} {cell} {unit}".rstrip())
            line = ", ".join([*parts, said] if said else parts)
            self._console.print(Text(line), soft_wrap=True)

    def _table(self) -> Table:
        """Return a table of the last pushes, as many as the terminal has room for."""
        table = Table(box=SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
        for i, name in enumerate(self._columns):
            table.add_column(Text(name), justify="right" if i else "left", no_wrap=True)
        table.add_column(overflow="fold")
        for row in self._rows[-max(self._console.height - 6, 1) :]:
            table.add_row(*map(Text, row))
        table.caption = Text(self._now, style="dim")
        return table


class LivePlot:
    """The last push and mu_s of all until now: in a window where there can be one, else in
    `live.png`, written anew after each push."""

    def __init__(self, folder: Path):
        self._path = folder / "live.png"
        self._pushes: list[LivePush | None] = []
        import matplotlib.pyplot as plt  # here, as it looks for a display

        self._pyplot: Any = plt if plt.get_backend().lower() in _WINDOWS else None
        size: Any = {"figsize": (9.0, 3.6), "layout": "constrained"}
        if self._pyplot:
            self._pyplot.ion()
            self._figure: Figure = self._pyplot.figure(**size)
        else:
            self._figure = Figure(**size)

    def add(self, found: LivePush | None, recording: Recording) -> None:
        """Draw a push and its recording into the figure."""
        self._pushes.append(found)
        draw_live(self._figure, self._pushes, recording)
        if self._pyplot:
            self._figure.canvas.draw_idle()
            self._pyplot.pause(0.001)
            return
        writing = self._path.with_name(".live.png.part")
        self._figure.savefig(writing, format="png", dpi=110)
        os.replace(writing, self._path)
