"""What a command leaves in its folder: result.json, a self-contained report.html, the figures."""

from __future__ import annotations

import base64
import io
import json
import os
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from difffric import leftovers
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
    """A page: a title, what it says in a line or two, and its sections."""

    title: str
    summary: Sequence[str]
    sections: Sequence[Section] = field(default_factory=tuple)

    @property
    def pictures(self) -> list[Picture]:
        """All figures of all sections, in order."""
        return [p for s in self.sections for p in s.pictures]


def render(report: Report) -> str:
    """Return the report as one HTML page, with its figures inside."""
    import jinja2  # here, so that a command without --out starts faster

    template = resources.files("difffric.commands.reports").joinpath("report_template.html")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string(template.read_text(encoding="utf-8"))
    images = {
        p.name: base64.b64encode(_render_png(p.figure, 130)).decode() for p in report.pictures
    }
    return page.render(report=report, images=images)


def _render_png(figure: Figure, dpi: int) -> bytes:
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # A name in letters that the font lacks is drawn as boxes; the tables have it whole.
        warnings.filterwarnings("ignore", r"Glyph \d+")
        figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def write_folder(
    folder: str | os.PathLike, answer: Any, report: Report, files: Mapping[str, bytes] | None = None
) -> Path:
    """Write result.json, report.html, the figures and other `files`; all of them or none, also
    where the process is told to end.

    Returns the folder. Raises `InputError` where it cannot be written.
    """
    contents = {
        **(files or {}),
        "result.json": (
            json.dumps(to_json_types(answer), indent=1, allow_nan=False) + "\n"
        ).encode(),
        "report.html": render(report).encode(),
        **{f"{p.name}.png": _render_png(p.figure, 150) for p in report.pictures},
    }
    with open_folder(folder) as path:
        staged = tempfile.TemporaryDirectory(dir=path, prefix=".writing-")
        with staged as staging, leftovers.guard(Path(staging)):
            for name, content in contents.items():
                (Path(staging) / name).write_bytes(content)
            with leftovers.PLACING:
                for name in contents:
                    os.replace(Path(staging) / name, path / name)
        return path
