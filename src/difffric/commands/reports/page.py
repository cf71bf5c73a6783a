"""What a command leaves in its folder: result.json, a self-contained report.html, the figures."""

from __future__ import annotations

import base64
import io
import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from difffric.errors import InputError

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
        """All figures, in order."""
        return [p for s in self.sections for p in s.pictures]


def number(value, digits: int = 4, unit: str = "") -> str:
    """A number for a person; a dash where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.{digits}g}{' ' + unit if unit else ''}"


def with_error(value, error, digits: int = 3) -> str:
    """value ± error; a dash where there is none."""
    if value is None:
        return "–"
    return (
        f"{value:.{digits}f} ± {error:.{digits}f}" if error is not None else f"{value:.{digits}f}"
    )


def rounded(value, error) -> tuple[str, str]:
    """A value and its standard error, to two digits of the error; a dash for none."""
    if value is None or not math.isfinite(value):
        return "–", "–"
    if error is None or not math.isfinite(error) or error <= 0:
        return number(value, 6), "–"
    places = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{places}f}", f"{error:.{places}f}"


def plain(answer):
    """The answer as JSON can hold it: Python's own types, null for what is not a number."""
    if isinstance(answer, Mapping):
        return {str(key): plain(value) for key, value in answer.items()}
    if isinstance(answer, (list, tuple)):
        return [plain(value) for value in answer]
    if isinstance(answer, (bool, np.bool_)):
        return bool(answer)
    if answer is None or isinstance(answer, str):
        return answer
    if isinstance(answer, (int, np.integer)):
        return int(answer)
    if np.ndim(answer) > 0:
        return plain(np.asarray(answer).tolist())
    value = float(answer)
    return value if math.isfinite(value) else None


def render(report: Report) -> str:
    """The page, with its figures inside."""
    import jinja2  # here, so that a command without --out starts faster

    template = resources.files("difffric.commands.reports").joinpath("report_template.html")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string(template.read_text(encoding="utf-8"))
    images = {p.name: base64.b64encode(_png(p.figure, 130)).decode() for p in report.pictures}
    return page.render(report=report, images=images)


def _png(figure: Figure, dpi: int) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def writable(folder: str | os.PathLike) -> Path:
    """The folder; `InputError` where it cannot be written to, or cannot be made.

    Nothing is left behind: a folder that is not there yet is made by `folder_for`.
    """
    path = Path(folder)
    there = next(p for p in (path, *path.absolute().parents) if p.exists())
    try:
        with tempfile.NamedTemporaryFile(dir=there):
            pass
    except OSError as error:
        raise InputError(f"{path}: cannot write here ({error.strerror}); give --out DIR") from error
    return path


@contextmanager
def folder_for(folder: str | os.PathLike) -> Iterator[Path]:
    """The folder, made if need be; made for nothing, it goes again."""
    path = writable(folder)
    missing = [p for p in (path, *path.parents) if not p.exists()]
    path.mkdir(parents=True, exist_ok=True)
    try:
        yield path
    except BaseException:
        for made in missing:
            with suppress(OSError):  # it holds something after all
                made.rmdir()
        raise


def write(
    folder: str | os.PathLike, answer, report: Report, files: Mapping[str, bytes] | None = None
) -> Path:
    """Write result.json, report.html, the figures and other `files`; all of them or none."""
    contents = {
        **(files or {}),
        "result.json": (json.dumps(plain(answer), indent=1, allow_nan=False) + "\n").encode(),
        "report.html": render(report).encode(),
        **{f"{p.name}.png": _png(p.figure, 150) for p in report.pictures},
    }
    with folder_for(folder) as path:
        with tempfile.TemporaryDirectory(dir=path, prefix=".writing-") as staging:
            for name, content in contents.items():
                (Path(staging) / name).write_bytes(content)
            for name in contents:
                os.replace(Path(staging) / name, path / name)
        return path
