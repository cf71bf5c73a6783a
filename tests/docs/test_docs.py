"""What the pages say is true: their Python runs, and their links lead somewhere."""

import re
import runpy
from pathlib import Path
from urllib.parse import unquote

import pytest

import difffric

ROOT = Path(__file__).parents[2]
TOP = [path for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md") if path.exists()]
PAGES = [*TOP, *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```\s*$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)")


def name(path):
    return str(path.relative_to(ROOT))


def blocks(path):
    """(line, code) of each Python block."""
    text = path.read_text(encoding="utf-8")
    for found in FENCE.finditer(text):
        if found[1] == "python":
            yield text.count("\n", 0, found.start(2)), found[2]


def prose(path):
    return re.sub(r"`[^`\n]*`", "", FENCE.sub("", path.read_text(encoding="utf-8")))


def anchors(path):
    """The page's headings, as GitHub turns them into anchors."""
    text = FENCE.sub("", path.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+\s+(.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("path", [page for page in PAGES if any(blocks(page))], ids=name)
def test_python_blocks_run(path, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "page"}
    for line, code in blocks(path):
        # Padded, so that a traceback shows the page's own line numbers.
        exec(compile("\n" * line + code, str(path), "exec"), namespace)


@pytest.mark.parametrize("path", PAGES, ids=name)
def test_links_lead_somewhere(path):
    broken = []
    for link in LINK.findall(prose(path)):
        if re.match(r"[a-z]+:", link):
            continue
        target, _, anchor = unquote(link).partition("#")
        page = (path.parent / target).resolve() if target else path
        if not page.exists() or (anchor and page.suffix == ".md" and anchor not in anchors(page)):
            broken.append(link)
    assert not broken


def test_no_module_is_named_as_a_public_name():
    """Importing such a module would put it in the function's place (decision 2)."""
    modules = {path.stem for path in (ROOT / "src" / "difffric").glob("*.py")}
    assert not modules & set(difffric.__all__)


def test_the_catalogue_is_that_of_the_code():
    page = (ROOT / "docs" / "catalogue.md").read_text(encoding="utf-8")
    made = runpy.run_path(str(ROOT / "docs" / "site" / "catalogue_page.py"))
    assert page == made["write_page"]()
