"""The report of every command, as it shows in a browser on a desk and on a telephone."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from difffric.commands.main import app
from difffric.units import to_mm_min
from tests.browser import SCHEMES, WIDTHS, browser, faults, find_pale_text, needs_chromium

__all__ = ["browser"]  # a fixture

EXAMPLES = Path(__file__).parents[2] / "examples"
SETUP, PUSHES, RING = EXAMPLES / "setup.toml", EXAMPLES / "pushes.csv", EXAMPLES / "ring.csv"
COMMANDS = {
    "simulate": (SETUP, "--velocity-mm-min", 3000),
    "family": (SETUP,),
    "check": (PUSHES, "--setup", SETUP),
    "fit": (PUSHES, "--setup", SETUP),
    "identify": (PUSHES, "--setup", "fit/setup.toml"),
    "acquire": ("--simulate", SETUP, "--velocity-mm-min", 3000, "--velocity-mm-min", 5000),
    "ring": (RING,),
    "plan": (SETUP, "--ring", RING),
    "centre": (SETUP, "--rings", 3),
    "monitor": (EXAMPLES / "watched.csv", "--setup", "fit/setup.toml"),
    "export": (SETUP, "--slowest-mm-min", 3000),
}
"""Each on the examples; a path without a folder is below the other commands' outputs."""
ELSEWHERE = {"diagnose", "init", "paper", "report-bug", "warm"}
"""The first two take long, and are looked at where they are run anyway, in test_procedure_tables.py
and test_paper.py; to warm the store and to begin a set-up leaves no page."""
ALARM = 3  # monitor's exit status where it raises one, as it does on the example
BAD = """
<!doctype html><meta charset="utf-8"><title>bad</title>
<body style="margin: 0; width: 90rem">
<img src="https://example.invalid/a.png" alt="from elsewhere">
<img src="gone.png" alt="gone">
<p>one line</p><p style="margin-top: -1.6rem">another line</p>
<p style="white-space: nowrap; width: 10rem">WIDE</p>
<p style="color: #999; background: #fff">a pale line</p>
<script>console.error("said"); undefined_function()</script>
""".replace("WIDE", "a line that is far too long for any page " * 8)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """`report(command)`: its report.html; a command is run once, when first asked for."""
    folder = tmp_path_factory.mktemp("reports")

    def report(command: str) -> Path:
        out = folder / command
        if not out.exists():
            arguments = [str(a) for a in COMMANDS[command]]
            for k, argument in enumerate(arguments):
                if argument.startswith("fit/"):
                    report("fit")
                    arguments[k] = str(folder / argument)
            done = CliRunner().invoke(app, [command, *arguments, "--out", str(out)])
            assert done.exit_code in (0, ALARM), done.output
        return out / "report.html"

    return report


def test_every_command_has_its_report_here():
    """One that is not listed here would never be looked at."""
    assert set(typer.main.get_command(app).commands) == COMMANDS.keys() | ELSEWHERE


@needs_chromium
def test_a_bad_page_is_found_out(browser, tmp_path):
    path = tmp_path / "bad.html"
    path.write_text(BAD)
    said = "\n".join(faults(browser, path, 1280))
    for fault in (
        "asks for https://example.invalid/a.png",
        "error: said",
        "undefined_function is not defined",
        'not loaded: "gone"',
        "the page scrolls sideways",
        'cut off: "a line that is far too long',
        'one over the other: "one line", "another line"',
        "contrast 2.85: a pale line",
    ):
        assert fault in said


@needs_chromium
@pytest.mark.parametrize("command", COMMANDS)
def test_the_report_shows_at_both_widths_and_in_both_schemes(browser, report, command):
    page = report(command)
    for width in WIDTHS:
        for scheme in SCHEMES:
            assert faults(browser, page, width, scheme=scheme) == [], (width, scheme)


@pytest.fixture
def opened(browser, report):
    """`opened(command)`: its report in a window on a desk."""
    pages = []

    def opened(command: str, **options):
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}} | options)
        pages.append(context.new_page())
        pages[-1].goto(report(command).as_uri())
        return pages[-1]

    yield opened
    for page in pages:
        page.context.close()


@needs_chromium
def test_a_table_is_sorted_by_pointer_and_keys_and_comes_back(opened):
    """d = 9595 µm stands behind 31 and before 12814: numbers are compared as numbers."""
    page = opened("fit")
    table = page.locator("table", has_text="own mu_s")
    heading = table.locator("th", has_text="model d")
    column = heading.evaluate("cell => cell.cellIndex")

    def read():
        return [
            float(row.split("\t")[column])
            for row in table.locator("tbody").inner_text().split("\n")
        ]

    given = read()
    assert given != sorted(given) and heading.get_attribute("aria-sort") == "none"
    heading.locator("button").click()
    assert read() == sorted(given) and heading.get_attribute("aria-sort") == "ascending"
    page.keyboard.press("Enter")  # the heading has the focus
    assert read() == sorted(given, reverse=True)
    assert heading.get_attribute("aria-sort") == "descending"
    page.keyboard.press("Enter")
    assert read() == given and heading.get_attribute("aria-sort") == "none"


def find_marks(page, figure: str):
    """Places in the window of the marks of a figure's first panel, one per push."""
    return page.evaluate(
        """(name) => {
          const figure = [...document.querySelectorAll('figure')].find(
            (one) => one.querySelector('figcaption').textContent.startsWith(name));
          figure.scrollIntoView({block: 'center'});
          const told = JSON.parse(figure.querySelector('script').textContent)[0];
          return told.parts.filter((part) => part.errors).flatMap((part) =>
            [...document.getElementById(part.id).querySelectorAll('use')].map((mark) => {
              const r = mark.getBoundingClientRect();
              return [r.left + r.width / 2, r.top + r.height / 2];
            }));
        }""",
        figure,
    )


@needs_chromium
def test_values_are_read_out_where_they_are_drawn_zoomed_or_not(opened, report):
    page = opened("fit")
    answer = json.loads(report("fit").with_name("result.json").read_text())
    measured = sorted(
        (to_mm_min(push["velocity_m_per_s"]), push["measured_peak_force_N"])
        for push in answer["pushes"]
    )
    readout = page.locator(".readout:visible")

    def read():
        """All marks of F_p over speed, as the read-out tells them."""
        found = []
        for x, y in find_marks(page, "F_p and d over speed"):
            page.mouse.move(x, y)
            words = readout.inner_text()
            assert "±" in words and words.split("\n")[0] in ("DRY", "OILY")
            values = re.search(r"v: ([\d.]+) mm/min.*: ([\d.]+) ± [\d.]+ N", words, re.DOTALL)
            found.append(tuple(map(float, values.groups())))
        return sorted(found)

    seen = read()
    assert len(seen) == len(measured)
    assert np.allclose(seen, measured, rtol=1e-5)
    marks = find_marks(page, "F_p and d over speed")
    (left, low), (right, high) = min(marks), max(marks)
    page.mouse.move(left - 4, low + 4)
    page.mouse.down()
    page.mouse.move((left + right) / 2, (low + high) / 2, steps=3)
    page.mouse.up()
    moved = find_marks(page, "F_p and d over speed")
    assert max(moved)[0] > right + 100  # beyond the panel's edge: it is zoomed
    x, y = min(moved)
    page.mouse.move(x, y)
    assert any(f": {force:.6g} ± " in readout.inner_text() for _, force in measured[:2])
    page.mouse.dblclick(x, y)
    assert np.allclose(find_marks(page, "F_p and d over speed"), marks)


@needs_chromium
def test_a_figure_is_read_and_zoomed_by_keys(opened):
    page = opened("fit")
    frame = page.locator(".plot", has=page.locator("svg")).nth(1)
    frame.focus()
    page.keyboard.press("ArrowRight")
    first = frame.locator(".readout").inner_text()
    page.keyboard.press("ArrowRight")
    assert first and frame.locator(".readout").inner_text() != first
    page.keyboard.press("+")
    assert "zoomed" in frame.get_attribute("class")
    page.keyboard.press("0")
    assert "zoomed" not in frame.get_attribute("class")


@needs_chromium
def test_a_wide_figure_scrolls_in_its_box_on_a_telephone(opened):
    page = opened("fit", viewport={"width": 400, "height": 900})
    boxes = page.locator(".plot").evaluate_all(
        "all => all.map((e) => [e.clientWidth, e.scrollWidth])"
    )
    assert all(own <= 400 for own, _ in boxes) and any(inner > own for own, inner in boxes)
    assert page.evaluate("document.documentElement.scrollWidth") == 400


@needs_chromium
def test_paper_is_white_in_the_dark_and_has_no_buttons(opened):
    page = opened("fit", color_scheme="dark")
    ground = "getComputedStyle(document.body).backgroundColor"
    assert page.evaluate(ground) != "rgb(255, 255, 255)"
    page.emulate_media(media="print")
    assert page.evaluate(ground) == "rgb(255, 255, 255)" and find_pale_text(page) == []
    assert not page.locator(".tools").first.is_visible()


@needs_chromium
def test_all_is_there_without_a_script(opened):
    page = opened("fit", java_script_enabled=False)
    assert page.locator("figure svg").count() >= 3
    assert page.locator("figure svg text", has_text="sliding distance").first.is_visible()
    assert page.locator("td", has_text="mu_s[DRY]").first.is_visible()
