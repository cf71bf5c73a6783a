"""The report of every command, as it shows in a browser on a desk and on a telephone."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from difffric.commands.main import app
from tests.browser import WIDTHS, browser, faults, needs_chromium

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
ELSEWHERE = {"diagnose", "init", "paper", "warm"}
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
    ):
        assert fault in said


@needs_chromium
@pytest.mark.parametrize("command", COMMANDS)
def test_the_report_shows_at_both_widths(browser, report, command):
    page = report(command)
    for width in WIDTHS:
        assert faults(browser, page, width) == [], width


@needs_chromium
def test_a_figure_grows_when_it_is_clicked_and_the_page_stays(browser, report):
    page = browser.new_page(viewport={"width": 400, "height": 900})
    page.goto(report("simulate").as_uri())
    figure = page.locator("figure img").first
    small = figure.bounding_box()["width"]
    figure.click()
    assert figure.bounding_box()["width"] > 1.5 * small
    assert page.evaluate("document.documentElement.scrollWidth") == 400
    page.close()
