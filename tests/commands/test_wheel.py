"""What is shipped: a wheel with all that the commands need, in an environment without the sources.

The environment of the Python that runs the tests sees the locked dependencies and nothing of this
repository. One of a later Python has its dependencies installed from wherever pip finds them.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from email.parser import Parser
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LATER = "DIFFFRIC_LATER_PYTHON"
"""Environment variable: a Python that is later than the one which runs the tests."""
CANDIDATES = ("python3.14", "python3.13", "python3.12")
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "--quiet")

pytestmark = pytest.mark.skipif(os.name == "nt", reason="paths in an environment are Unix's here")


def do(*command, **options):
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, timeout=1200, **options
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, as the build backend makes it."""
    folder = tmp_path_factory.mktemp("wheel")
    do(*PIP, "wheel", ROOT, "--no-deps", "--no-build-isolation", "--no-index", "-w", folder)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The bin of an environment with the wheel, beside the locked dependencies."""
    folder = tmp_path_factory.mktemp("installed") / "venv"
    venv.create(folder, symlinks=True)
    bin_ = folder / "bin"
    # --ignore-installed: what an environment beside has is nobody's to take away.
    do(*PIP, "--python", bin_ / "python", "install", "-I", "--no-deps", "--no-index", wheel)
    (packages,) = folder.glob("lib/python*/site-packages")
    # In a .pth of ours the files *.pth of that folder count for nothing: its difffric is unseen.
    (packages / "locked.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return bin_


@pytest.fixture(scope="module")
def later(wheel):
    """The same of a later Python, with dependencies of its own, made once for each lock."""
    python = find_later_python()
    lock = hashlib.sha256((ROOT / "requirements.lock").read_bytes() + python.encode()).hexdigest()
    folder = ROOT / ".pytest_cache" / f"later-{lock[:16]}"
    bin_, ready = folder / "bin", folder / "ready"
    if not ready.exists():
        shutil.rmtree(folder, ignore_errors=True)
        do(python, "-m", "venv", folder)
        install = [bin_ / "python", *PIP[1:], "install", "--prefer-binary", wheel]
        done = subprocess.run(install, capture_output=True, text=True, timeout=1200)
        if done.returncode != 0:
            shutil.rmtree(folder, ignore_errors=True)
            pytest.skip(f"{python}: the dependencies could not be installed: {done.stderr[-300:]}")
        ready.touch()
    do(bin_ / "python", *PIP[1:], "install", "--force-reinstall", "--no-deps", "--no-index", wheel)
    return bin_


def find_later_python() -> str:
    """A later Python; skips where there is none that can make an environment."""
    for name in filter(None, (os.environ.get(LATER), *CANDIDATES)):
        code = "import sys, ensurepip, venv; print(sys.version_info[:2], sys.executable, sep='|')"
        try:
            done = subprocess.run([name, "-c", code], capture_output=True, text=True, timeout=60)
        except OSError:
            continue
        told, _, path = done.stdout.strip().partition("|")
        if done.returncode == 0 and told > str(sys.version_info[:2]):
            return path
    pytest.skip(f"no later Python here (looked for {', '.join(CANDIDATES)}); {LATER} names one")


def run_outside(bin_: Path, folder: Path, *words, cache: Path | None = None) -> str:
    """What a command of an environment prints, started in a folder without anything of ours."""
    folder.mkdir(exist_ok=True)
    kept = {name: os.environ[name] for name in ("PATH", "XLA_FLAGS") if name in os.environ}
    environment = kept | {"HOME": str(folder), "XDG_CACHE_HOME": str(cache or folder / "cache")}
    return do(bin_ / words[0], *words[1:], cwd=folder, env=environment)


def list_sources() -> set[str]:
    """All files of the package, as a wheel has them."""
    source = ROOT / "src"
    files = (p for p in (source / "difffric").rglob("*") if p.is_file())
    return {p.relative_to(source).as_posix() for p in files if "__pycache__" not in p.parts}


def test_the_wheel_has_every_file_of_the_package_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as content:
        names = {name for name in content.namelist() if ".dist-info/" not in name}
    assert names == list_sources()
    assert {Path(name).suffix for name in names} >= {".py", ".pyi", ".html", ".csv", ".c", ".h"}


def test_the_wheel_says_what_it_is_and_needs(wheel):
    with zipfile.ZipFile(wheel) as content:
        (path,) = (x for x in content.namelist() if x.endswith(".dist-info/METADATA"))
        told = Parser().parsestr(content.read(path).decode())
        (entries,) = (x for x in content.namelist() if x.endswith(".dist-info/entry_points.txt"))
        assert "difffric = difffric.commands.main:main" in content.read(entries).decode()
        assert any(x.endswith("licenses/LICENSE") for x in content.namelist())
    assert told["Requires-Python"] == ">=3.11" and told["License-Expression"] == "Apache-2.0"
    needed = {x.partition(">")[0] for x in told.get_all("Requires-Dist") if ";" not in x}
    assert {"jax", "equinox", "optimistix", "typer", "jinja2"} <= needed
    assert not needed & {"pytest", "hypothesis", "sphinx", "distributed"}


def test_the_installed_command_needs_nothing_of_the_repository(installed, tmp_path):
    where = run_outside(installed, tmp_path, "python", "-c", "import difffric; print(difffric)")
    assert str(installed.parent) in where and str(ROOT) not in where
    assert run_outside(installed, tmp_path, "difffric", "--version").startswith("difffric 0.")
    shutil.copy(ROOT / "examples" / "setup.toml", tmp_path)
    shutil.copy(ROOT / "examples" / "pushes.csv", tmp_path)
    words = ("identify", "pushes.csv", "--setup", "setup.toml", "--out", "out", "--quiet")
    run_outside(installed, tmp_path, "difffric", *words)
    assert (tmp_path / "out" / "report.html").read_text().rstrip().endswith("</html>")
    tables = "import difffric as df; df.studies.published_tables.load_pushes()"
    run_outside(installed, tmp_path, "python", "-c", tables)


def check_demo(bin_, tmp_path):
    run_outside(bin_, tmp_path, "difffric", "paper", "--out", "X", "--quiet")
    written = {p.name for p in (tmp_path / "X").iterdir()}
    assert {"result.json", "report.html", "errors.png", "explained.png"} <= written


def test_the_demo_runs_from_the_wheel(installed, tmp_path):
    check_demo(installed, tmp_path)


def test_the_demo_runs_from_the_wheel_on_a_later_python(later, tmp_path):
    assert run_outside(later, tmp_path, "difffric", "--version").startswith("difffric 0.")
    check_demo(later, tmp_path)


def test_the_citation_can_be_read():
    yaml = pytest.importorskip("yaml")
    told = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= told.keys()
    assert told["version"] == metadata.version("difffric")
    assert told["license"] == metadata.metadata("difffric")["License-Expression"]
