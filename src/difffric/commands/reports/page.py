"""What a command leaves in its folder: result.json, a self-contained report.html, the figures."""

from __future__ import annotations

import io
import json
import os
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from difffric import leftovers
from difffric.commands.layout.table_columns import holds_numbers, leave_out_empty
from difffric.output_folder import open_folder, to_json_types

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NO_STROKE = (
    "No stroke is given: the pusher stops at the first loss of contact, and d depends on it."
)


@dataclass(frozen=True)
class Table:
    """A table of a report: a caption, headings, and rows of text."""

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    @property
    def numbers(self) -> list[bool]:
        """Whether each column holds numbers."""
        return [holds_numbers(cells) for cells in zip(*self.rows, strict=True)]

    def leave_out_empty(self) -> Table:
        """Return the table without columns that say nothing."""
        return Table(self.caption, *leave_out_empty(self.columns, self.rows))


@dataclass(frozen=True)
class Picture:
    """A figure of a report, written as NAME.png too."""

    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True)
class Section:
    """A heading with text, tables and figures, in this order."""

    heading: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()


@dataclass(frozen=True)
class Report:
    """A page: a title, what it says, its sections, and what to do with it.

    The first line of the summary is the verdict. Summary and advice are the page's first, and what
    a reader without time reads: whole sentences.
    """

    title: str
    summary: Sequence[str]
    sections: Sequence[Section] = field(default_factory=tuple)
    advice: Sequence[str] = ()
    """what to do next, a line for each thing"""
    command: str = ""
    """what to type for the last of these, in one line that can be copied"""

    @property
    def pictures(self) -> list[Picture]:
        """All figures of all sections, in order."""
        return [p for s in self.sections for p in s.pictures]


def render(report: Report) -> str:
    """Return the report as one HTML page, with its figures inside."""
    # Here, so that a command without --out starts faster.
    import jinja2

    from difffric.commands.layout.svg_figure import draw_svg

    drawn = {p.name: draw_svg(p.figure, f"figure{i}") for i, p in enumerate(report.pictures)}
    sections = [
        replace(one, tables=[table.leave_out_empty() for table in one.tables])
        for one in report.sections
    ]
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(_read("page.html")).render(
        report=report,
        sections=sections,
        drawn=drawn,
        colours={k: v for one in drawn.values() for k, v in one.colours.items()},
        style=_read("page.css"),
        script="\n".join(map(_read, _SCRIPTS)),
    )


_SCRIPTS = ("figure_axes.js", "figure_parts.js", "figures.js", "tables.js")


def _read(name: str) -> str:
    return resources.files("difffric.commands.layout").joinpath(name).read_text(encoding="utf-8")


def _render_png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # A name in letters that the font lacks is drawn as boxes; the tables have it whole.
        warnings.filterwarnings("ignore", r"Glyph \d+")
        figure.savefig(buffer, format="png", dpi=150)
    return buffer.getvalue()


def format_answer(answer: Any) -> str:
    """Return what result.json holds of an answer."""
    return json.dumps(to_json_types(answer), indent=1, allow_nan=False) + "\n"


def write_folder(
    folder: str | os.PathLike, answer: Any, report: Report, files: Mapping[str, bytes] | None = None
) -> Path:
    """Write result.json, report.html, the figures and other `files`; all of them or none, also
    where the process is told to end.

    Returns the folder. Raises `InputError` where it cannot be written.
    """
    contents = {
        **(files or {}),
        "result.json": format_answer(answer).encode(),
        **{f"{p.name}.png": _render_png(p.figure) for p in report.pictures},
        "report.html": render(report).encode(),
    }
    with open_folder(folder) as path:
        staged = tempfile.TemporaryDirectory(dir=path, prefix=".writing-")
        # Whoever ends the process knows of the folder until it is gone.
        with leftovers.guard(Path(staged.name)), staged as staging:
            for name, content in contents.items():
                (Path(staging) / name).write_bytes(content)
            with leftovers.PLACING:
                for name in contents:
                    os.replace(Path(staging) / name, path / name)
        return path
