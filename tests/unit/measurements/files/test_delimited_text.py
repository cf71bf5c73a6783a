"""Text of cells as spreadsheets and loggers write it: one table, whatever way it is written."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from difffric.errors import InputError
from difffric.measurements.files.decimal_marks import find_decimal_mark, write_with_point
from difffric.measurements.files.delimited_text import decode_text, split_text
from difffric.measurements.files.named_columns import read_columns
from difffric.measurements.headings import HeadingError, read_heading
from difffric.measurements.quantities import QUANTITIES, MeasuredQuantity
from difffric.units import UNITS, find_unit
from difffric.value_ranges import ANY

SAMPLES = (
    MeasuredQuantity("time_s", "time", ANY),
    MeasuredQuantity("force_N", "force", ANY),
    MeasuredQuantity("position_mm", "position", ANY, "0.001"),
    MeasuredQuantity("condition", "condition"),
)


def read(tmp_path, text, **options):
    path = tmp_path / "axis.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_columns(path, SAMPLES, **options)


# Units


@pytest.mark.parametrize("unit", UNITS, ids=lambda u: u.symbol)
def test_a_unit_is_found_by_all_of_its_spellings_and_by_no_others(unit):
    for text in (unit.symbol, *unit.spellings):
        assert find_unit(text) is unit
        assert find_unit(f" {text} ") is unit
    assert sum(unit.symbol in (u.symbol, *u.spellings) for u in UNITS) == 1


@pytest.mark.parametrize(
    ("text", "symbol"),
    [("µm", "um"), ("μm", "um"), ("m s^-1", "m/s"), ("mm·min⁻¹", "mm/min"), ("m_per_s", "m/s")],
)
def test_a_unit_is_found_in_the_ways_of_print(text, symbol):
    unit = find_unit(text)
    assert unit is not None and unit.symbol == symbol


def test_units_are_what_the_standards_say():
    si = {u.symbol: u.in_si for u in UNITS}
    assert si["lbf"] == pytest.approx(0.45359237 * 9.80665, rel=1e-15)
    assert si["in"] == 0.0254 and si["kN"] == 1000.0 and si["um"] == 1e-6
    assert si["mm/min"] == pytest.approx(1e-3 / 60, rel=1e-15)
    assert si["in/min"] == pytest.approx(si["in"] / 60, rel=1e-15)


# Headings


@pytest.mark.parametrize("pattern", ["{} [{}]", "{} ({})", "{}_{}", "{} / {}", "{} in {}", "{} {}"])
@pytest.mark.parametrize("q", [q for q in QUANTITIES if q.own_unit], ids=lambda q: q.key)
def test_a_heading_says_its_unit_in_any_way_that_people_write(q, pattern):
    for unit in (u for u in UNITS if u.of == q.own_unit.of):
        for stem in (q.stem, q.stem.replace("_", " ").capitalize(), *q.also):
            name = pattern.format(stem, unit.symbol)
            heading = read_heading(name, QUANTITIES)
            assert heading.quantity.attribute == q.attribute
            assert float(heading.quantity.unit) / heading.quantity.per == unit.in_si
            assert bool(heading.note) == (unit.symbol != q.own_unit.symbol)


@pytest.mark.parametrize(
    "name", ["peak_force_mm", "d [kg]", "velocity (N)", "F_p [furlong]", "mass"]
)
def test_a_heading_without_a_unit_that_fits_is_refused(name):
    with pytest.raises(HeadingError, match="expected"):
        read_heading(name, QUANTITIES)


# Decimal marks


@given(st.decimals("-99999", "99999", places=4), st.sampled_from([".", ","]))
def test_a_number_is_read_with_either_mark_and_with_marks_of_thousands(x, mark):
    thousands = {".": ",", ",": "."}[mark]
    for grouped in (f"{x:,.4f}", f"{x:.4f}"):
        cell = grouped.translate(str.maketrans({",": thousands, ".": mark}))
        assert find_decimal_mark([cell], None) == mark
        assert float(write_with_point(cell, mark)) == float(x)
    blanks = f"{x:,.4f}".replace(",", "\u202f").replace(".", mark)
    assert float(write_with_point(blanks, mark)) == float(x)


def test_what_may_be_either_mark_is_decided_by_the_others_or_not_at_all():
    assert find_decimal_mark(["1,500", "30.5"], None) == "."
    assert find_decimal_mark(["1,500", "30,5"], None) == ","
    assert find_decimal_mark(["1.500", "2.000"], None) == "."
    assert find_decimal_mark(["1,500", "2,000"], None) is None
    assert find_decimal_mark(["1,500", "2,000"], ",") == ","
    assert find_decimal_mark(["1,500", "2.000"], ",") is None
    assert find_decimal_mark(["12", None, ""], None) == "."
    assert write_with_point("12,34,5", ".") is None and write_with_point("1,23.5", ".") is None


# Texts


@pytest.mark.parametrize("codec", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be",
                                   "utf-32", "cp1252"])  # fmt: skip
def test_a_text_is_decoded_whatever_it_was_saved_as(codec):
    text = "position [µm];Größe\n1;2\n" * 3
    found, notes = decode_text(text.encode(codec), "x.csv")
    assert found.lstrip("\ufeff") == text
    assert bool(notes) == (codec == "cp1252")


@pytest.mark.parametrize("separator", [",", ";", "\t", "|", " "])
@pytest.mark.parametrize("head", ["", "# a remark\n", "\n\n", "sep={}\n"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_cells_are_found_between_any_separators(separator, head, end):
    if separator == " " and "sep" in head:
        return
    rows = [["time_s", "force_N"], ["0.5", "-3"], ["1.5", "4e-3"]]
    text = head.format(separator) + "\n".join(separator.join(row) for row in rows) + "\n"
    found = split_text(text.replace("\n", end), "x.csv")
    assert [found.header, *found.rows] == rows
    assert found.separator == separator
    assert found.lines == [2 + head.count("\n"), 3 + head.count("\n")]


def test_a_row_of_units_a_commented_header_and_no_header(tmp_path):
    for text in (
        "time\tforce\tposition\nms\tkN\tinch\n1500\t0.25\t2\n",
        "# logger 7\n# time_ms force_kN position_in\n1500 0.25 2\n",
        "time [ms];force [kN];position [in];\n1500;0,25;2;\n",
    ):
        found = read(tmp_path, text)
        read_back = [found.values[x].tolist() for x in ("time", "force", "position")]
        assert read_back == [[1.5], [250.0], [0.0508]]
        assert len([note for note in found.notes if "converted" in note]) == 3
    bare = read(tmp_path, "1.5 250 2\n", channels={"time": "1", "force_N": "2"})
    assert bare.values.keys() == {"time", "force"} and bare.values["force"].tolist() == [250.0]


def test_foreign_names_are_mapped_and_asked_for_by_name(tmp_path):
    def find_needed(found):
        return [("time",), ("force",), ("position",)]

    text = "Zeit [ms];Kraft [kN];Weg [mm];Bemerkung\n1;2;3;x\n"
    with pytest.raises(InputError) as caught:
        read(tmp_path, text, find_needed=find_needed)
    (line,) = str(caught.value).splitlines()
    names = {"time": "Zeit [ms]", "force": "Kraft [kN]", "position": "Weg [mm]"}
    for ours, theirs in names.items():
        assert f"--channel {ours}='{theirs}'" in line
    for channels in (names, {ours: theirs.split()[0] for ours, theirs in names.items()}):
        found = read(tmp_path, text, find_needed=find_needed, channels=channels, pass_over=True)
        assert [found.values[x][0] for x in names] == [0.001, 2000.0, 0.003]
        assert found.passed_over == ("Bemerkung",)
    with pytest.raises(InputError, match="not there, found: Zeit"):
        read(tmp_path, text, channels={"force": "Strom"}, pass_over=True)
    with pytest.raises(InputError, match="kraft is unknown, known: time, force"):
        read(tmp_path, text, channels={"kraft": "Kraft"}, pass_over=True)


def test_many_rows_are_read_as_each_is_alone(tmp_path):
    rng = np.random.default_rng(0)
    t, F, x = np.arange(3000) / 1000, rng.normal(0, 9, 3000), rng.normal(0, 1, 3000)
    rows = [f"{a:.3f};{b:.4f};{c:.5f}".replace(".", ",") for a, b, c in zip(t, F, x, strict=True)]
    found = read(tmp_path, "\n".join(["time_s;force_kN;position_mm", *rows]))
    assert np.array_equal(found.values["time"], np.round(t, 3))
    assert np.array_equal(found.values["force"], [float(f"{v:.4f}e3") for v in F])
    assert np.array_equal(found.values["position"], [float(f"{v:.5f}e-3") for v in x])
    assert found.lines[-1] == 3001 and found.problems == []


def test_a_mark_of_thousands_is_a_slip_where_the_file_has_thousands_without(tmp_path):
    found = read(tmp_path, 'time_s,force_N\n0.5,"2,000"\n0.6,"1,999"\n')
    assert found.values["force"].tolist() == [2000.0, 1999.0] and found.problems == []
    found = read(tmp_path, 'time_s,force_N\n0.5,2000\n0.6,"122,188"\n')
    assert [line for line, _ in found.problems] == [3] and np.isnan(found.values["force"][1])
    found = read(tmp_path, 'time_s,force_N\n0.5,2000\n0.6,"1,999.5"\n')
    assert found.values["force"].tolist() == [2000.0, 1999.5]
