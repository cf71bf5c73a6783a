"""What the pages say is true: their Python runs, and their links lead somewhere."""

import ast
import importlib
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

import difffric
from tests.public import is_public, public_names

ROOT = Path(__file__).parents[2]
SRC = ROOT / "src"
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


def test_no_module_takes_the_place_of_a_public_name():
    """Importing a module makes it an attribute of its package: a function must not be there."""
    for package, names in public_names():
        folder = ROOT.joinpath("src", *package.split("."))
        modules = {path.stem for path in folder.glob("*.py")}
        packages = {path.parent.name for path in folder.glob("*/__init__.py")}
        assert not names & (modules | packages), package


def test_a_package_does_not_shadow_a_function():
    code = (
        "import difffric as df, difffric.calibration.calibrate, difffric.fleet.archive\n"
        "assert callable(df.fit) and callable(df.calibration.fit) and callable(df.family)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize("stub", sorted(SRC.rglob("__init__.pyi")), ids=name)
def test_each_name_of_a_stub_is_there(stub):
    """lazy_loader looks a name up when it is first used: a wrong line would go unnoticed."""
    package = importlib.import_module(".".join(stub.parent.relative_to(SRC).parts))
    lines = [x for x in ast.parse(stub.read_text()).body if isinstance(x, ast.ImportFrom)]
    names = {alias.name for line in lines for alias in line.names}
    assert names == set(package.__all__)
    assert not [name for name in names if not hasattr(package, name)]


def test_the_import_is_light():
    code = "import sys, difffric; sys.exit(bool({'jax', 'numpy'} & {*sys.modules}))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_name_that_has_moved_is_still_there_and_says_where_it_is():
    with pytest.warns(DeprecationWarning, match=r"difffric\.rig\.ViscousCoulomb"):
        assert difffric.ViscousCoulomb is difffric.rig.ViscousCoulomb
    for name, package in difffric._MOVED.items():
        with pytest.warns(DeprecationWarning):
            assert getattr(difffric, name) is getattr(getattr(difffric, package), name)
        assert name not in difffric.__all__
    with pytest.raises(AttributeError):
        _ = difffric.no_such_name


def imports(code):
    """(module, name) of each import of difffric's in a piece of Python."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("difffric"):
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                package, _, name = alias.name.rpartition(".")
                if package.startswith("difffric"):
                    yield package, name


def examples():
    """(where it stands, code) of all Python that the pages and notebooks show."""
    for page in PAGES:
        yield from ((f"{name(page)}:{line}", code) for line, code in blocks(page))
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
            if cell["cell_type"] == "code":
                code = "".join(cell["source"])
                yield name(notebook), re.sub(r"^\s*[%!].*$", "", code, flags=re.MULTILINE)


def test_examples_import_public_names_only():
    wrong = [
        f"{where}: from {module} import {what}"
        for where, code in examples()
        for module, what in imports(code)
        if not is_public(module, what)
    ]
    assert not wrong


def test_the_catalogue_is_that_of_the_code():
    page = (ROOT / "docs" / "catalogue.md").read_text(encoding="utf-8")
    made = runpy.run_path(str(ROOT / "docs" / "site" / "catalogue_page.py"))
    assert page == made["write_page"]()
