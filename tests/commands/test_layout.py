"""What a report looks like: tables within a terminal's width, colours for dark ground, figures
whose parts say what they are, and `--json`."""

from __future__ import annotations

import io
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console

from difffric.commands.figures.style import make_figure, name_curve, write_name
from difffric.commands.layout.dark_colours import GROUND, WHITE, measure_contrast, to_dark
from difffric.commands.layout.panel_description import write_plain
from difffric.commands.layout.svg_figure import draw_svg
from difffric.commands.layout.table_columns import holds_numbers, leave_out_empty
from difffric.commands.layout.terminal_tables import lay_out
from difffric.commands.reports.page import Picture, Report, Section, Table, render
from tests.browser import SCHEMES, WIDTHS, browser, faults, needs_chromium

__all__ = ["browser"]  # a fixture

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = (
    r"$\frac{a$",
    "[red]x[/red]",
    "<script>alert(1)</script>",
    "_x",
    "トルク",
    "a " * 80,
    "x" * 200,
)
"""What a person may call a condition, a push or a file."""


def show(columns, rows, width: int, caption: str = "caption") -> str:
    """A table as a terminal of this width shows it."""
    console = Console(file=io.StringIO(), width=width, markup=False, emoji=False, highlight=False)
    for block in lay_out(caption, columns, rows, width):
        console.print(block)
    return console.file.getvalue()


numbers = st.floats(-1e9, 1e9).map(lambda x: f"{x:.5g}") | st.just("–")
texts = st.text("abcdef ", min_size=1, max_size=120) | st.sampled_from(NAMES) | st.just("–")


@given(
    st.lists(st.booleans(), min_size=1, max_size=14),
    st.integers(1, 5),
    st.integers(60, 200),
    st.data(),
)
def test_no_row_is_wider_than_the_terminal_and_every_number_is_whole(kinds, n, width, data):
    columns = [f"quantity {j} [mm/min]" for j in range(len(kinds))]
    rows = [[data.draw(numbers if kind else texts) for kind in kinds] for _ in range(n)]
    said = show(columns, rows, width)
    assert all(cell_len(line) <= width for line in said.splitlines())
    kept, cells = leave_out_empty(columns, rows)
    for j in range(len(kept)):
        column = [row[j] for row in cells]
        if holds_numbers(column) and all(re.fullmatch(r"[\d.e+–-]+", x) for x in column):
            assert all(x in said for x in column if x != "–")


def test_a_long_text_leaves_room_for_numbers_in_every_block():
    rows = [["a " * 30, *["a"] * 2, "1.0001e+05", *["a"] * 3]]
    said = show([f"quantity {j} [mm/min]" for j in range(7)], rows, 62)
    assert "1.0001e+05" in said and max(map(cell_len, said.splitlines())) <= 62


def test_a_column_that_says_nothing_is_left_out_and_the_first_one_stays():
    rows = [["–", "1", "–", ""], ["", "2", "–", "x"]]
    assert leave_out_empty(("a", "b", "c", "d"), rows) == (
        ["a", "b", "d"],
        [["–", "1", ""], ["", "2", "x"]],
    )
    assert leave_out_empty(("a", "b"), []) == (["a", "b"], [])


@pytest.mark.parametrize(
    ("cells", "numeric"),
    [
        (["1.5", "–", "-2e3"], True),
        (["0.14 ± 0.01", "not determined", "3"], True),
        (["≤ 3", "12 of 14"], True),
        (["DRY", "OILY"], False),
        (["push 1", "push 2"], False),
        (["–", ""], False),
    ],
)
def test_a_column_of_numbers_is_known(cells, numeric):
    assert holds_numbers(cells) is numeric


def test_names_are_shortened_in_the_middle_before_a_table_is_split():
    row = ["hall-1/press-3/2026-09/0002.tdms/push 0001", *["12345.678"] * 5]
    said = show(("push", *"abcde"), [row], 76)
    assert "hall-1/press-3/20…h 0001" in said and "continued" not in said


colours = st.integers(0, 0xFFFFFF).map(lambda x: f"#{x:06x}")


@given(colours)
def test_a_colour_is_as_well_to_see_on_dark_ground_as_on_white(colour):
    """But for black: 21 would dazzle."""
    on_white, on_dark = measure_contrast(colour, WHITE), measure_contrast(to_dark(colour), GROUND)
    assert abs(on_dark - min(on_white, 14.0)) < 0.35


def test_contrasts_are_those_of_wcag():
    assert measure_contrast("#000000", "#ffffff") == pytest.approx(21)
    assert measure_contrast("#777777", "#ffffff") == pytest.approx(4.478, abs=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_text_in_a_figure_and_in_what_is_told_of_it(name):
    figure, ax = make_figure()
    ax.plot([1, 2], [1, 2], label=write_name(name))
    ax.plot([1, 2], [2, 1], label=name_curve("model", name))
    ax.set_title(write_name(name, 300))
    ax.legend()
    drawn = draw_svg(figure, "figure0")
    told = [part["name"] for part in drawn.panels[0]["parts"] if part.get("line")]
    assert told == [write_plain(write_name(name)), f"model, {write_plain(write_name(name))}"]
    title = " ".join(name.split())
    assert title.replace(" ", "") in "".join(ET.fromstring(drawn.svg).itertext()).replace(" ", "")


def test_formulas_are_told_as_plain_text():
    assert write_plain("peak push force $F_p$ [N]") == "peak push force F_p [N]"
    assert write_plain(r"$\mu_s$ = 0.14") == "mu_s = 0.14"
    assert write_plain(r"\$x\$") == "$x$"
    assert write_plain("3 $") == "3 $"


def test_every_colour_of_a_figure_has_its_dark_one_and_every_name_is_used_once():
    figures = [make_figure()[0] for _ in range(2)]
    for figure in figures:
        figure.axes[0].errorbar([1, 2], [1, 2], [0.1, 0.2], fmt="o", color="#1f6f8b", label="DRY")
    drawn = [draw_svg(figure, f"figure{i}") for i, figure in enumerate(figures)]
    for one in drawn:
        used = set(re.findall(r"var\(--c(\w+)\)", one.svg))
        assert used and used <= {colour[1:] for colour in one.colours}
        assert not re.search(r"(fill|stroke): #", one.svg)
    names = [name for one in drawn for name in re.findall(r' id="([^"]+)"', one.svg)]
    assert len(names) == len(set(names))
    for one in drawn:
        referred = set(re.findall(r'(?:href="#|url\(#)([^")]+)', one.svg))
        assert referred <= set(re.findall(r' id="([^"]+)"', one.svg))


def test_error_bars_and_maps_are_told_with_their_values():
    figure, (left, right) = make_figure(2)
    left.errorbar([1, 2, np.nan], [3, 4, 5], [0.1, 0.25, 1.0], fmt="s", label="OILY")
    right.imshow([[1.0, np.nan], [3.0, 4.0]], origin="lower", extent=(0, 2, 10, 20), aspect="auto")
    first, second = draw_svg(figure, "figure0").panels
    part = next(x for x in first["parts"] if x.get("errors"))
    assert part["name"] == "OILY" and np.allclose(part["errors"], [[1, 3, 0.1], [2, 4, 0.25]])
    assert second["map"] == {
        "x": [0, 2], "y": [10, 20], "shape": [2, 2], "values": [1, None, 3, 4]
    }  # fmt: skip


@pytest.fixture(scope="module")
def odd_page(tmp_path_factory):
    """A report of odd names."""
    with matplotlib.rc_context():
        figure, ax = make_figure()
        for i, name in enumerate(NAMES):
            ax.errorbar([1, 2], [i, i + 1], [0.1, 0.1], fmt="o", label=write_name(name))
        ax.set(xscale="log", xlabel="speed [mm/min]", ylabel=write_name(NAMES[0]))
        ax.legend(loc="upper left", fontsize=7)
    rows = [[name, "1.5 ± 0.1", "–", name] for name in NAMES]
    table = Table(NAMES[0], ("condition", "mu_s", "nothing", "remark"), rows)
    section = Section("Names", NAMES, [table], [Picture("odd", " ".join(NAMES[:3]), figure)])
    page = tmp_path_factory.mktemp("odd") / "report.html"
    page.write_text(render(Report(NAMES[2], NAMES, [section], NAMES)), encoding="utf-8")
    return page


@needs_chromium
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_odd_names_break_no_page(browser, odd_page, width, scheme):
    assert faults(browser, odd_page, width, scheme=scheme) == []


@needs_chromium
def test_names_are_shown_as_they_are(browser, odd_page):
    page = browser.new_page()
    page.goto(odd_page.as_uri())
    cells = page.locator("td:first-child").all_inner_texts()
    assert [x.strip() for x in cells] == [" ".join(name.split()) for name in NAMES]
    assert page.locator("th").count() == 3  # without the column that says nothing
    page.close()


def test_json_is_what_the_file_holds_and_nothing_else(run, tmp_path):
    out = tmp_path / "out"
    code, said, errors = run("ring", EXAMPLES / "ring.csv", "--json", "--out", out)
    assert (code, errors) == (0, "")
    assert said == (out / "result.json").read_text() and json.loads(said)["offset_m"] > 0
    code, alone, _ = run("ring", EXAMPLES / "ring.csv", "--json")
    assert alone == said
    code, words, _ = run("ring", EXAMPLES / "ring.csv")
    assert code == 0 and words.startswith("The centre is")


def test_json_keeps_an_error_off_standard_output(run, tmp_path):
    code, said, errors = run("ring", tmp_path / "gone.csv", "--json")
    assert code == 2 and not said and errors.count("\n") == 1


def test_every_command_with_a_result_has_json():
    from difffric.commands import main

    for name in main.COMMANDS:
        options = [x for p in main.load_command(name).params for x in p.opts]
        assert ("--json" in options) is (name not in main.WITHOUT_RESULT), name
