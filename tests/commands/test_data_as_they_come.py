"""The same pushes in thirty ways of writing them; thirty wrong files, each with its remedy; names
that look like formulas, markup or commands of a terminal."""

from __future__ import annotations

import csv
import json
import warnings
from dataclasses import replace as with_changes
from itertools import chain

import numpy as np
import pytest

import difffric as df
from difffric.commands.figures.style import make_figure, write_name
from difffric.measurements.files import workbook
from difffric.measurements.pushes import COLUMNS
from difffric.name_text import make_printable, shorten_name
from tests.commands.variants import (
    EXAMPLES,
    FORCES,
    GERMAN,
    LENGTHS,
    RECORDINGS,
    SE,
    TABLES,
    C,
    D,
    F,
    M,
    Table,
    V,
    copy_recordings,
    rename,
    write_workbook,
)

SETUP = EXAMPLES / "setup.toml"
TRUTH = df.load(EXAMPLES / "pushes.csv")
RECORDED = df.load(EXAMPLES / "pushes.tdms")


# The same pushes


def test_there_are_thirty_variants_at_least():
    assert len(TABLES) + len(RECORDINGS) >= 30


def assert_same_table(read):
    for column in COLUMNS:
        ours, theirs = getattr(TRUTH, column), getattr(read, column)
        if column == "condition":
            assert theirs == ours
        else:
            assert np.allclose(theirs, ours, rtol=1e-14, atol=0, equal_nan=True), column


@pytest.mark.parametrize("name", TABLES)
def test_a_table_says_the_same_in_whatever_way_it_is_written(tmp_path, name):
    table = TABLES[name]
    read = df.load(table.write(tmp_path / "pushes.csv"), channels=table.channels)
    assert_same_table(read)
    converted = [i for i in table.units if i in (V, F, D, *SE, M)]
    assert sum("converted from" in note for note in read.notes) >= len(converted)


def test_a_workbook_says_the_same(tmp_path):
    pytest.importorskip("fastexcel")
    read = df.load(write_workbook(tmp_path / "pushes.xlsx"))
    assert_same_table(read)
    (tmp_path / "bad.xlsx").write_text("velocity_mm_min")
    with pytest.raises(df.InputError, match=r"bad\.xlsx: not an Excel workbook"):
        df.load(tmp_path / "bad.xlsx")


def test_a_workbook_asks_for_what_reads_it(tmp_path, monkeypatch):
    monkeypatch.setattr(workbook, "find_spec", lambda name: None)
    with pytest.raises(df.InputError, match=r"save the sheet as CSV UTF-8, or pip install"):
        df.load(write_workbook(tmp_path / "pushes.xlsx"))


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_say_the_same_in_whatever_units_and_names_they_are(tmp_path, name):
    changes, channels = RECORDINGS[name]
    read = df.load(copy_recordings(tmp_path / "pushes.tdms", **changes), channels=channels)
    for ours, theirs in zip(RECORDED, read, strict=True):
        for key in ("velocity", "mass", "stroke"):
            assert getattr(theirs, key) == pytest.approx(getattr(ours, key), rel=1e-14)
        assert theirs.condition == ours.condition
        for key in ("force", "position"):
            a, b = getattr(ours, key).samples, getattr(theirs, key).samples
            assert np.allclose(b, a, rtol=1e-14, atol=0)
    assert all(note.endswith("(in 14 of 14 pushes)") for note in read.notes)


def test_the_set_up_and_the_command_line_say_foreign_names(run, tmp_path):
    data = TABLES["German names"].write(tmp_path / "pushes.csv")
    setup = tmp_path / "setup.toml"
    said = '\n[files]\npeak_force = "Kraft"\nsliding_distance = "Weg"\n'
    setup.write_text(SETUP.read_text() + said)
    folders = tmp_path / "named", tmp_path / "plain"
    given = ("--channel", "velocity=Geschwindigkeit", "--out", folders[0], "--quiet")
    assert run("identify", data, "--setup", setup, *given)[0] == 0
    plain = ("--out", folders[1], "--quiet")
    assert run("identify", EXAMPLES / "pushes.csv", "--setup", SETUP, *plain)[0] == 0
    named, same = (json.loads((folder / "result.json").read_text()) for folder in folders)
    assert named["pushes"] == same["pushes"]
    assert any("decimal commas" in note for note in named["data_notes"])


# Wrong ones


def change(old, new, **options):
    """The table with a text replaced."""
    return Table(change=lambda text: text.replace(old, new, 1), **options)


WRONG = {
    "kN under N": (Table(units=FORCES), "forces look like kN", "peak_force_kN"),
    "mm under um": (Table(units=LENGTHS), "distances look like mm", "sliding_distance_mm"),
    "inch under um": (Table(units={D: "in"}), "distances look like in", "sliding_distance_in"),
    "m/s under mm/min": (Table(units={V: "m/s"}), "speeds look like m/s", "velocity_m_per_s"),
    "mm/s under mm/min": (Table(units={V: "mm/s"}), "speeds look like mm/s", "mm_per_s"),
    "g under kg": (Table(units={M: "g"}), "masses look like g", "mass_g"),
    "German names": (Table(names=GERMAN), "--channel velocity=", "found Geschwindigkeit"),
    "German names with units": (
        Table(names={V: "Geschw. [mm/min]", F: "Kraft [N]", D: "Weg [um]"}),
        "--channel velocity='Geschw. [mm/min]' --channel peak_force",
    ),
    "no header": (Table(without_header=True), "--channel velocity=NUMBER"),
    "no unit": (Table(names={V: "velocity"}), "velocity [unit] with m/s, mm/s"),
    "unknown unit": (Table(names={F: "force [kx]"}), "'kx' is not known, expected N, mN"),
    "a force in mm": (Table(names={F: "force [mm]"}), "in mm, expected peak_force in N, mN, kN"),
    "a slip": (Table(names={F: "peak_froce_N"}), "unknown, expected peak_force_N"),
    "a column twice": (Table(names={D: "peak_force_N"}), "2 times, expected once"),
    "a quantity twice": (Table(names={D: "F_p [kN]"}), "peak_force_N is that already"),
    "a remark": (Table(names={C: "remark"}), "remark: unknown", "--skip-bad passes it over"),
    "no name": (Table(names={C: ""}), "column 6 has no name"),
    "bare decimal commas": (change("122.188", "122,188"), "put semicolons between cells"),
    "one decimal comma": (change("122.188", '"122,188"'), "is a comma meant as the decimal"),
    "doubtful thousands": (
        Table(head='velocity_mm_min,peak_force_N\n"2,000",122\n', change=lambda x: x[:46]),
        "write numbers without thousands marks",
    ),
    "a unit in a cell": (change("122.188", "122.188 N"), "the unit stands in the heading"),
    "text in a cell": (change("122.188", "about 120"), "expected a number > 0"),
    "a negative force": (change("122.188", "-122.188"), "expected a number > 0"),
    "an open quote": (change("122.188", '"122.188'), "a quote that does not close"),
    "nothing": (Table(change=lambda text: ""), "empty, expected a header and a row"),
    "a header alone": (Table(change=lambda text: text[: text.index("\n")]), "no rows below"),
    "a picture": (Table(change=lambda text: "\x89PNG", codec="latin-1"), "a picture, not text"),
    "a workbook": (Table(change=lambda text: "PK\x03\x04"), "save it as CSV"),
    "MATLAB's": (Table(change=lambda text: "MATLAB 5.0 MAT-file"), "writetable"),
    "TDMS under another name": (Table(change=lambda text: "TDSm"), "the suffix .tdms"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_table_is_refused_with_its_remedy_in_the_first_line(run, tmp_path, name):
    table, *expected = WRONG[name]
    data = table.write(tmp_path / "pushes.csv")
    code, _, said = run("identify", data, "--setup", SETUP, "--quiet")
    first = said.splitlines()[0]
    assert code == 2 and first.startswith(f"difffric: {data}: ")
    for words in expected:
        assert words in first


WRONG_RECORDINGS = {
    "kN under N": ({"units": {"force": ("N", 1e-3)}}, "unit_string kN"),
    "mm under um": ({"units": {"position": ("um", 1e-3)}}, "unit_string mm"),
    "no probe": ({"units": {"position": ("um", 0.0)}}, "the probe never moved", "14 of 14"),
    "no sensor": ({"units": {"force": ("N", 0.0)}}, "is the sensor connected?", "14 of 14"),
    "German names": (
        {"names": {"force": "Kraft", "position": "Weg"}},
        "--channel force=Kraft --channel position=Weg (in 14 of 14 pushes)",
    ),
    "no unit": ({"units": {"force": ("", 1.0)}}, "--channel force_N='force'", "14 of 14"),
    "unknown unit": ({"units": {"force": ("kx", 1.0)}}, "expected N or V", "(in 14 of 14 pushes)"),
    "no speed": (
        {"properties": rename(velocity_mm_min=("tempo", 1.0))},
        "velocity_mm_min: missing",
        "(in 14 of 14 pushes)",
    ),
}


@pytest.mark.parametrize("name", WRONG_RECORDINGS)
def test_wrong_recordings_are_refused_once_for_all_pushes(run, tmp_path, name):
    changes, *expected = WRONG_RECORDINGS[name]
    data = copy_recordings(tmp_path / "pushes.tdms", **changes)
    code, _, said = run("identify", data, "--setup", SETUP, "--quiet")
    lines = [line for line in said.splitlines() if line.startswith("difffric: ")]
    assert code == 2 and len(said.splitlines()) == len(lines) == 1
    for words in expected:
        assert words in lines[0]


def test_units_are_taken_as_they_are_where_that_is_asked_for(run, tmp_path):
    data = Table(units=LENGTHS).write(tmp_path / "pushes.csv")
    assert run("identify", data, "--setup", SETUP, "--trust-units", "--quiet")[0] == 0


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ("force", "OURS=THEIRS"),
        ("=x", "OURS=THEIRS"),
        ("farce=x", "farce is unknown, known"),
        ("kraft=force", "kraft is not ours; write it as force=kraft?"),
    ],
)
def test_a_channel_that_says_nothing_is_refused(run, option, expected):
    data = EXAMPLES / "pushes.csv"
    code, _, said = run("identify", data, "--setup", SETUP, "--channel", option, "--quiet")
    assert code == 2 and expected in said.splitlines()[0]


# A name is text

NAMES = (
    r"$\frac{a$",
    "$x_{$",
    r"\$x$",
    "[red]x[/red]",
    "[/]",
    "_hidden",
    "<b>&lt;</b><script>alert(1)</script>",
    "a very long name " * 40,
    "日本 :warning: \x1b[31mred",
)


@pytest.mark.parametrize("name", NAMES)
def test_a_figure_draws_a_name_as_it_is(name):
    shown = write_name(name)
    figure, ax = make_figure()
    ax.plot([0, 1], label=shown)
    ax.set_xlabel(rf"$\mu_s$ {shown}")
    ax.set_title(shown)
    legend = ax.legend()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "Glyph")
        figure.canvas.draw()
    assert len(legend.get_texts()) == 1 and len(shown) <= 30


def test_a_name_is_shortened_in_the_middle_and_printable():
    assert shorten_name("DRY", 24) == "DRY"
    assert shorten_name("DRY  \n old", 24) == "DRY old"
    assert shorten_name("a" * 30 + "b" * 30, 24) == "a" * 17 + "…" + "b" * 6
    assert make_printable("\x1b[31mred\x07") == " [31mred "


def test_names_go_through_a_whole_command_as_text(run, tmp_path):
    def rename_conditions(text):
        rows = list(csv.reader(text.splitlines()))
        names = chain.from_iterable([NAMES] * 2)
        for row, name in zip(rows[1:], names, strict=False):
            row[C] = name
        out = [",".join('"' + cell.replace('"', '""') + '"' for cell in row) for row in rows]
        return "\n".join(out) + "\n"

    data = Table(change=rename_conditions).write(tmp_path / "pushes.csv")
    code, out, said = run("identify", data, "--setup", SETUP, "--out", tmp_path / "out", "--quiet")
    assert code == 0 and said == ""
    for name in NAMES[:6]:
        assert f"{name}: mu_s = " in out
    assert "\x1b" not in out and ":warning:" in out
    answer = json.loads((tmp_path / "out" / "result.json").read_text())
    assert list(answer["conditions"]) == [name.strip() for name in NAMES]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<script>alert" not in page and "&lt;script&gt;alert(1)" in page


@pytest.mark.parametrize("column", ["velocity", "peak_force", "sliding_distance", "mass"])
@pytest.mark.parametrize("value", [1e-300, 1e300])
def test_extreme_numbers_print_no_warning_of_ours(run, tmp_path, column, value):
    from difffric.measurements.files.table_csv import write_table

    numbers = getattr(TRUTH, column).copy()
    numbers[3] = value
    write_table(with_changes(TRUTH, **{column: numbers}), tmp_path / "pushes.csv")
    options = ("--use-data-mass", "--trust-units", "--quiet")
    # A warning of our own code is an error in the tests.
    code, _, said = run("identify", tmp_path / "pushes.csv", "--setup", SETUP, *options)
    assert code in (0, 1, 2) and "Warning" not in said
