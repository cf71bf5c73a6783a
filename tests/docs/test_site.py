"""The docs site is whole: it builds without a warning, holds all that is public, and shows in a
browser without asking for anything from elsewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.browser import SCHEMES, WIDTHS, browser, faults, needs_chromium
from tests.public import public_names

__all__ = ["browser"]  # a fixture

ROOT = Path(__file__).parents[2]
PAGES = (
    "index",
    "docs/new_setup",
    "docs/glossary",
    "docs/model",
    "docs/effects",
    "docs/catalogue",
    "docs/formats",
    "docs/performance",
    "docs/site/reference",
    "docs/decisions/README",
    "notebooks/01_the_paper",
)


def build(root: Path, out: Path):
    """What `make docs` does, but for the notebooks, which tests/docs/test_notebooks.py runs."""
    options = ("--fail-on-warning", "--keep-going", "--quiet", "-D", "nb_execution_mode=off")
    places = ("-c", root / "docs" / "site", "-d", out.with_name("doctrees"), root, out)
    command = [sys.executable, "-m", "sphinx", *options, *map(str, places)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("built") / "site"
    done = build(ROOT, out)
    assert done.returncode == 0, done.stderr
    return out


def test_the_reference_has_every_public_name_once():
    """Where difffric itself has a name of a package, it stands there alone."""
    page = (ROOT / "docs" / "site" / "reference.rst").read_text(encoding="utf-8")
    shown = {}
    for line in re.finditer(r"^\.\. (currentmodule|auto\w+):: (\S+)$", page, re.MULTILINE):
        if line[1] == "currentmodule":
            listed = shown.setdefault(line[2], [])
        else:
            listed.append(line[2])
    top, *packages = public_names()
    assert sorted(shown.pop("difffric")) == sorted(top[1])
    expected = {name: sorted(own - top[1]) for name, own in packages}
    assert {name: sorted(x) for name, x in shown.items()} == {
        name: own for name, own in expected.items() if own
    }


def test_every_page_is_there_and_links_stay_inside(site):
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        assert (site / page.relative_to(ROOT).with_suffix(".html")).exists(), page
    for page in site.rglob("*.html"):
        for link in re.findall(r"(?:src|href)=\"([^\"#?]+)", page.read_text(encoding="utf-8")):
            if not re.match(r"[a-z]+:", link):
                assert (page.parent / link).exists(), f"{page.relative_to(site)}: {link}"


def test_formulas_are_drawn_without_a_script(site):
    page = (site / "docs" / "model.html").read_text(encoding="utf-8")
    assert page.count("<math") > 50 and "\\mu" not in page and "mathjax" not in page.lower()


def test_broken_links_and_formulas_fail_the_site(tmp_path):
    """A site of two pages, by the same rules."""
    docs = tmp_path / "docs"
    (docs / "site" / "static").mkdir(parents=True)
    (docs / "site" / "static" / "site.css").touch()
    conf = (ROOT / "docs" / "site" / "conf.py").read_text(encoding="utf-8")
    few = 'CONTENTS = {"Pages": ["docs/page"]}\n'
    (docs / "site" / "conf.py").write_text(conf + few, encoding="utf-8")
    (tmp_path / "README.md").write_text("# Start\n")
    (docs / "page.md").write_text("# Page\n\n[start](../README.md#start), $\\mu_s$\n")
    good = build(tmp_path, tmp_path / "out" / "good")
    assert good.returncode == 0, good.stderr
    (docs / "page.md").write_text("# Page\n\n[a](gone.md), [b](../README.md#lost), $\\nosuch x$\n")
    bad = build(tmp_path, tmp_path / "out" / "bad")
    assert bad.returncode != 0
    for said in ("'gone.md'", "lost", "not known in a formula: \\nosuch x"):
        assert said in bad.stderr


@needs_chromium
@pytest.mark.parametrize("page", PAGES)
def test_pages_show_at_both_widths_and_in_both_schemes(browser, site, page):
    path = site / f"{page}.html"
    for width in WIDTHS:
        for scheme in SCHEMES:
            assert faults(browser, path, width, "article", scheme) == [], (width, scheme)


@needs_chromium
def test_the_search_answers_without_a_server(browser, site):
    said = []
    page = browser.new_page()
    page.on("console", lambda message: said.append(message.text))
    page.goto((site / "search.html").as_uri() + "?q=stribeck")
    page.wait_for_selector("#search-results li a")
    assert "The catalogue" in page.inner_text("#search-results") and not said
    page.close()
