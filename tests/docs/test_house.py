"""The rules of CONTRIBUTING that a machine can hold, and that each import contract can fail."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from studies import house

ROOT = Path(__file__).parents[2]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
    "importlinter"
]["contracts"]
MODULES = house.read_modules()

BREAKS = {
    "Packages import down only": ("rig/contact.py", "import difffric.commands.main"),
    "No circles inside a package": ("rig/contact.py", "import difffric.rig.rig"),
    "The recorder knows no physics": ("acquisition/recorder.py", "import difffric.rig.friction"),
    "An axis knows no push tip and no JAX": ("axis/setup.py", "import difffric.rig.rig"),
    "Physics reads no files": ("simulation/observables.py", "import difffric.rig.setup_toml"),
    "The figures' style imports nothing of ours": (
        "commands/figures/style.py",
        "import difffric.studies.paper",
    ),
}
"""For each contract an import that must not be: the file that it is put into, and the line."""


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A copy of the package with its contracts."""
    folder = tmp_path_factory.mktemp("tree")
    shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def broken(tree):
    """The names of the contracts that import-linter finds broken in a tree."""
    done = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache", "--no-logo"],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree / "src"), "COLUMNS": "200", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
    )
    assert "Contracts:" in done.stdout, done.stdout + done.stderr
    return set(re.findall(r"^(\S.*\S) BROKEN", done.stdout, re.MULTILINE))


def test_every_contract_holds_and_has_an_import_that_breaks_it(tree):
    assert broken(tree) == set()
    assert BREAKS.keys() == {contract["name"] for contract in CONTRACTS}


@pytest.mark.parametrize("name", BREAKS)
def test_a_contract_can_fail(tree, name):
    place, line = BREAKS[name]
    path = tree / "src" / "difffric" / place
    before = path.read_text(encoding="utf-8")
    path.write_text(f"{before}\n{line}\n", encoding="utf-8")
    try:
        assert name in broken(tree)
    finally:
        path.write_text(before, encoding="utf-8")


def test_the_layers_are_a_dozen_lines():
    (layers,) = (contract["layers"] for contract in CONTRACTS if contract["type"] == "layers")
    assert len(layers) <= 14


def test_no_folder_is_crowded_and_no_file_long():
    assert house.crowded_folders(MODULES) == []
    assert house.long_files(MODULES) == []


def test_the_arguments_of_public_functions_say_what_they_are():
    assert house.annotated_share(MODULES) >= house.LEAST_ANNOTATED


def test_no_class_name_stands_for_two_things():
    assert house.names_twice(MODULES) == []


def test_constants_say_why():
    assert [x for module in MODULES for x in house.wordless_constants(module)] == []


def test_functions_are_verbs():
    assert [x for module in MODULES for x in house.no_verbs(module)] == []


def test_every_package_has_a_guide():
    guides = [m for m in MODULES if m.path.name == "__init__.py"]
    assert [m.name for m in guides if len((house.docstring(m) or "").split()) < 20] == []


def test_every_module_says_what_it_is():
    assert [m.name for m in MODULES if not house.docstring(m)] == []
