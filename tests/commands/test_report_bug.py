"""An unexpected failure is one line, and is kept for a report without what is the user's own."""

from __future__ import annotations

import re
from importlib.metadata import version
from pathlib import Path

import pytest

from difffric.commands.running import durations, last_error
from difffric.commands.running.versions import list_versions

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def fault(monkeypatch, tmp_path):
    """A command that meets a fault of ours, whose words have the user's file in them."""
    monkeypatch.setenv(durations.CACHE, str(tmp_path / "cache"))
    file = tmp_path / "secret_customer.csv"
    file.write_text((EXAMPLES / "pushes.csv").read_text())

    def fail(rig, loaded, **options):
        raise IndexError(f"{file}: row 7 of {file.name}")

    monkeypatch.setattr("difffric.commands.identify.df.identify", fail)
    return "identify", file, "--setup", EXAMPLES / "setup.toml"


def test_versions_begin_with_our_own():
    first, *others = list_versions()
    assert first == f"difffric {version('difffric')}"
    told = " ".join(others)
    for name in ("jax", "jaxlib", "equinox", "optimistix", "diffrax", "lineax", "numpy"):
        assert f"{name} {version(name)}" in told
    assert "Python 3." in told and "64 bits" in told


def test_the_version_needs_no_command(run):
    status, out, error = run("--version")
    assert status == 0 and out.splitlines() == list_versions() and error == ""


def test_a_fault_is_one_line_that_says_how_to_report_it(run, fault):
    status, out, error = run(*fault)
    assert status == 1 and out == "" and "Traceback" not in error
    (line,) = error.splitlines()
    assert line.startswith("difffric: a fault of difffric, IndexError at difffric/commands/")
    assert "difffric report-bug" in line


def test_the_report_has_the_fault_and_no_name_of_a_file(run, fault, tmp_path):
    run(*fault)
    status, out, _ = run("report-bug")
    assert status == 0
    assert "difffric identify <name 1>.csv --setup <name 2>.toml" in out
    assert "IndexError: <name 1>.csv: row 7 of <name 1>.csv" in out
    assert re.search(r'File "difffric/commands/identify\.py", line \d+, in identify', out)
    assert all(line in out for line in list_versions())
    assert "secret" not in out and str(tmp_path) not in out and str(EXAMPLES) not in out
    assert str(Path.home()) not in out and "please read them before you send this" in out
    run("report-bug", "--out", tmp_path / "report.md")
    assert (tmp_path / "report.md").read_text() == out


def test_bad_input_is_no_fault(run, monkeypatch, tmp_path):
    monkeypatch.setenv(durations.CACHE, str(tmp_path))
    assert run("identify", tmp_path / "none.csv", "--setup", EXAMPLES / "setup.toml")[0] == 2
    assert last_error.read_error() is None
    assert "None was kept." in run("report-bug")[1]


def test_a_report_that_cannot_be_written_is_one_line(run, tmp_path):
    status, _, error = run("report-bug", "--out", tmp_path / "none" / "report.md")
    assert status == 2 and len(error.splitlines()) == 1 and "report.md" in error


def test_words_of_ours_stay_and_words_of_the_user_go():
    error = ValueError("left and right differ")
    words = ["fit", "a b.csv", "--setup=my rig.toml", "--free", "mu_s", "--channel", "F=left"]
    told = last_error.describe_error(error, words)
    command = "difffric fit <name 1>.csv --setup=<name 2>.toml --free mu_s --channel <name 3>"
    assert command in told and "my rig" not in told
