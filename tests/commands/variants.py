"""Files as people have them, made from `examples/`: the same pushes in other ways, and wrong ones.

It knows units and formats by itself and imports nothing of difffric.
"""

from __future__ import annotations

import csv
import io
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from nptdms import ChannelObject, GroupObject, TdmsFile, TdmsWriter

EXAMPLES = Path(__file__).parents[2] / "examples"
_ROWS = list(csv.reader((EXAMPLES / "pushes.csv").read_text().splitlines()))
HEADER, ROWS = _ROWS[0], _ROWS[1:]
V, F, D, M, S, C = (HEADER.index(x) for x in (
    "velocity_mm_min", "peak_force_N", "sliding_distance_um", "mass_kg", "stroke_mm", "condition"
))  # fmt: skip
SE = HEADER.index("peak_force_se_N"), HEADER.index("sliding_distance_se_um")

# How many of the contract's units one of another is.
PER = {
    "kN": Decimal(1000),
    "mN": Decimal("0.001"),
    "lbf": Decimal("4.4482216152605"),
    "mm": Decimal(1000),
    "m": Decimal(1000000),
    "in": Decimal(25400),
    "m/s": Decimal(60000),
    "mm/s": Decimal(60),
    "in/min": Decimal("25.4"),
    "g": Decimal("0.001"),
    "stroke m": Decimal(1000),
    "stroke in": Decimal("25.4"),
}


@dataclass
class Table:
    """A way to write the table of `examples/pushes.csv`."""

    names: Mapping[int, str] = field(default_factory=dict)
    """column -> its heading"""
    units: Mapping[int, str] = field(default_factory=dict)
    """column -> its unit"""
    separator: str = ","
    mark: str = "."
    codec: str = "utf-8"
    end: str = "\n"
    head: str = ""
    below: Sequence[str] = ()
    """a row below the header"""
    group: str = ""
    """what stands between thousands"""
    quotes: int = csv.QUOTE_MINIMAL
    without_header: bool = False
    change: Callable[[str], str] = lambda text: text
    channels: Mapping[str, str] = field(default_factory=dict)
    """what the reader is told"""

    def write(self, path: Path) -> Path:
        """Write it as a .csv."""
        text = io.StringIO()
        writer = csv.writer(
            text,
            delimiter=self.separator,
            lineterminator="\n",
            quoting=self.quotes,  # type: ignore
        )
        if not self.without_header:
            writer.writerow([self.names.get(i, name) for i, name in enumerate(HEADER)])
        if self.below:
            writer.writerow(self.below)
        for row in ROWS:
            writer.writerow([self._write_cell(i, cell) for i, cell in enumerate(row)])
        whole = self.change(self.head + text.getvalue()).replace("\n", self.end)
        path.write_bytes(whole.encode(self.codec))
        return path

    def _write_cell(self, i: int, cell: str) -> str:
        if i == C:
            return cell
        x = Decimal(cell) / PER.get(self.units.get(i, ""), Decimal(1))
        plain = f"{x:,f}" if self.group else f"{x:f}"
        return plain.replace(",", "\0").replace(".", self.mark).replace("\0", self.group)


FORCES = {F: "kN", SE[0]: "kN"}
LENGTHS = {D: "mm", SE[1]: "mm"}
GERMAN = {V: "Geschwindigkeit", F: "Kraft", D: "Weg"}
SAID = {"velocity": "Geschwindigkeit", "peak_force": "Kraft", "sliding_distance": "Weg"}


def head(pattern: str, **units: str) -> dict[int, str]:
    """Headings of speed, force and distance by a pattern of name and unit."""
    own = {"v": "mm/min", "F": "N", "d": "um"} | units
    names = {"v": "velocity", "F": "peak_force", "d": "sliding_distance"}
    return {i: pattern.format(names[k], own[k]) for i, k in ((V, "v"), (F, "F"), (D, "d"))}


TABLES: dict[str, Table] = {
    "as it is": Table(),
    "semicolons, decimal commas": Table(separator=";", mark=","),
    "semicolons, decimal points": Table(separator=";"),
    "tabs, decimal commas": Table(separator="\t", mark=","),
    "tabs": Table(separator="\t"),
    "bars": Table(separator="|"),
    "commas, quoted decimal commas": Table(mark=","),
    "all cells quoted": Table(quotes=csv.QUOTE_ALL),
    "decimal commas, thousands points": Table(separator=";", mark=",", group="."),
    "thousands commas in quotes": Table(group=","),
    "thin blanks between thousands": Table(separator=";", mark=",", group="\u202f"),
    "Swiss apostrophes": Table(separator=";", group="'"),
    "UTF-8 with a mark": Table(codec="utf-8-sig"),
    "UTF-16": Table(codec="utf-16", separator="\t", mark=","),
    "UTF-16 without a mark": Table(codec="utf-16-le"),
    "Latin-1": Table(codec="latin-1", names=head("{} [{}]", d="µm")),
    "Windows' line ends": Table(end="\r\n", separator=";", mark=","),
    "old Macs' line ends": Table(end="\r"),
    "Excel's sep": Table(head="sep=;\n", separator=";", mark=","),
    "comments above": Table(head="# rig 7\n# measured on Monday\n\n"),
    "empty columns to the right": Table(change=lambda text: text.replace("\n", ",,\n")),
    "empty rows": Table(change=lambda text: text.replace("\n", "\n,,\n")),
    "units in brackets": Table(names=head("{} [{}]")),
    "units in parentheses": Table(names=head("{} ({})", d="µm")),
    "units after a slash": Table(names=head("{} / {}")),
    "capitals and blanks": Table(names={V: "Velocity mm/min", F: "Peak Force [N]", D: "D [µm]"}),
    "symbols": Table(names={V: "v [mm/min]", F: "F_p [N]", D: "d [µm]", M: "m [kg]"}),
    "kN and mm": Table(
        names=head("{}_{}", v="mm_min", F="kN", d="mm")
        | {SE[0]: "peak_force_se_kN", SE[1]: "sliding_distance_se_mm"},
        units=FORCES | LENGTHS,
    ),
    "m/s, lbf, inch": Table(
        names={V: "velocity_m_per_s", F: "peak_force [lbf]", D: "sliding distance (inch)"},
        units={V: "m/s", F: "lbf", D: "in"},
    ),
    "mm/s, mN, m": Table(
        names={V: "velocity_mm_s", F: "force [mN]", D: "distance in m"},
        units={V: "mm/s", F: "mN", D: "m"},
    ),
    "in/min, g, m": Table(
        names={V: "velocity [in/min]", M: "mass_g", S: "stroke [m]"},
        units={V: "in/min", M: "g", S: "stroke m"},
    ),
    "a row of units": Table(
        names={V: "velocity", F: "force", D: "distance"},
        units={V: "m/s", F: "kN", D: "mm"},
        separator="\t",
        below=["m/s", "kN", "mm", *[""] * (len(HEADER) - 3)],
    ),
    "German names": Table(names=GERMAN, separator=";", mark=",", channels=SAID),
    "German names and units": Table(
        names={V: "Geschwindigkeit [m/s]", F: "Kraft [kN]", D: "Weg [mm]"},
        units={V: "m/s", F: "kN", D: "mm"},
        separator=";",
        mark=",",
        codec="cp1252",
        channels=SAID,
    ),
    "no header": Table(
        without_header=True,
        separator=";",
        mark=",",
        channels={name: str(i + 1) for i, name in enumerate(HEADER)},
    ),
}


def copy_recordings(
    path: Path,
    *,
    names: Mapping[str, str] = {},
    units: Mapping[str, tuple[str, float]] = {},
    properties: Callable[[dict[str, Any]], dict[str, Any]] = lambda says: says,
) -> Path:
    """Write the recordings of `examples/` with other channel names, units (and how many of them one
    is) and group properties."""
    objects: list[Any] = []
    for group in TdmsFile.read(EXAMPLES / "pushes.tdms").groups():
        objects.append(GroupObject(group.name, properties(dict(group.properties))))
        for channel in group.channels():
            says = {k: v for k, v in channel.properties.items() if not k.startswith("NI_")}
            unit, factor = units.get(channel.name, (says["unit_string"], 1.0))
            samples = np.asarray(channel[:], float) * factor
            says["unit_string"] = unit
            if not unit:
                del says["unit_string"]
            name = names.get(channel.name, channel.name)
            objects.append(ChannelObject(group.name, name, samples, says))
    with TdmsWriter(path) as writer:
        writer.write_segment(objects)
    return path


def rename(**names: tuple[str, float]) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Properties under another name, times a factor."""

    def change(says: dict[str, Any]) -> dict[str, Any]:
        return {
            names[k][0] if k in names else k: v * names[k][1] if k in names else v
            for k, v in says.items()
        }

    return change


RECORDINGS: dict[str, tuple[dict[str, Any], dict[str, str]]] = {
    "kN and m": ({"units": {"force": ("kN", 1e-3), "position": ("m", 1e-6)}}, {}),
    "lbf and inch": (
        {"units": {"force": ("lbf", 1 / 4.4482216152605), "position": ("inch", 1 / 25400)}},
        {},
    ),
    "mN and a Greek µ": ({"units": {"force": ("mN", 1e3), "position": ("\u03bcm", 1.0)}}, {}),
    "German names": (
        {"names": {"force": "Kraft", "position": "Weg"}},
        {"force": "Kraft", "position": "Weg"},
    ),
    "no unit, and told": ({"units": {"force": ("", 1.0)}}, {"force_N": "force"}),
    "m/s, g and m": (
        {"properties": rename(
            velocity_mm_min=("velocity_m_per_s", 1 / 60000),
            mass_kg=("mass [g]", 1000.0),
            stroke_mm=("stroke_m", 1e-3),
        )},
        {},
    ),
}  # fmt: skip


_SCHEMAS = "http://schemas.openxmlformats.org/"
_TYPES = "application/vnd.openxmlformats-"
_SHEETS = f"{_TYPES}officedocument.spreadsheetml"
_LINKS = f"{_SCHEMAS}officeDocument/2006/relationships"


def _link(kind: str, target: str) -> str:
    """What says that a part of a workbook belongs to another."""
    return (
        f'<Relationships xmlns="{_SCHEMAS}package/2006/relationships">'
        f'<Relationship Id="r1" Type="{_LINKS}/{kind}" Target="{target}"/></Relationships>'
    )


_WORKBOOK = {
    "[Content_Types].xml": (
        f'<Types xmlns="{_SCHEMAS}package/2006/content-types">'
        f'<Default Extension="rels" ContentType="{_TYPES}package.relationships+xml"/>'
        f'<Override PartName="/xl/workbook.xml" ContentType="{_SHEETS}.sheet.main+xml"/>'
        f'<Override PartName="/xl/sheet1.xml" ContentType="{_SHEETS}.worksheet+xml"/></Types>'
    ),
    "_rels/.rels": _link("officeDocument", "xl/workbook.xml"),
    "xl/_rels/workbook.xml.rels": _link("worksheet", "sheet1.xml"),
    "xl/workbook.xml": (
        f'<workbook xmlns="{_SCHEMAS}spreadsheetml/2006/main" xmlns:r="{_LINKS}">'
        '<sheets><sheet name="pushes" sheetId="1" r:id="r1"/></sheets></workbook>'
    ),
}
"""What a workbook of one sheet consists of, beside the sheet."""


def write_workbook(path: Path) -> Path:
    """Write the table of `examples/pushes.csv` as an Excel workbook."""

    def write_cell(cell: str) -> str:
        try:
            return f"<c><v>{float(cell)!r}</v></c>"
        except ValueError:
            return f'<c t="inlineStr"><is><t>{cell}</t></is></c>'

    rows = "".join(f"<row>{''.join(map(write_cell, row))}</row>" for row in (HEADER, *ROWS))
    sheet = (
        f'<worksheet xmlns="{_SCHEMAS}spreadsheetml/2006/main">'
        f"<sheetData>{rows}</sheetData></worksheet>"
    )
    with zipfile.ZipFile(path, "w") as book:
        for name, text in {**_WORKBOOK, "xl/sheet1.xml": sheet}.items():
            book.writestr(name, '<?xml version="1.0" encoding="UTF-8"?>' + text)
    return path
