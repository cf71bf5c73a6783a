"""The list of commands is there at once, and each command comes when it is called."""

import inspect
import os
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from difffric.commands import main


def test_the_list_of_commands_imports_none_of_them():
    heavy = {"jax", "numpy", "matplotlib", "scipy", "difffric.commands.options"}
    code = (
        "import sys\nfrom difffric.commands.main import app\n"
        "app(['--help'], standalone_mode=False)\n"
        f"sys.exit(', '.join({heavy} & {{*sys.modules}}) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(f"│ {name} " in done.stdout for name in main.COMMANDS)


@pytest.mark.parametrize("name", main.COMMANDS)
def test_the_help_of_a_command_loads_nothing_that_only_its_work_needs(name, monkeypatch):
    """Neither what computes nor what checks and converts arguments; yet it is typer's own help."""
    heavy = {"jax", "numpy", "matplotlib", "scipy", "polars", "pydantic", "platformdirs"}
    heavy |= {"rich.progress", "difffric.commands.reports.page"}
    code = (
        "import sys\nfrom difffric.commands.main import app\n"
        "app(sys.argv[1:], prog_name='difffric', standalone_mode=False)\n"
        f"sys.exit(', '.join({heavy} & {{*sys.modules}}) or 0)"
    )
    call = [sys.executable, "-c", code, name, "--help"]
    done = subprocess.run(call, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert f"Usage: difffric {name} " in done.stdout and "--help" in done.stdout
    monkeypatch.setattr(main, "prepare_jax", lambda: None)
    usual = CliRunner().invoke(main.app, [name, "x", "--help"], prog_name="difffric")
    assert done.stdout.split() == usual.output.split()


@pytest.mark.parametrize("name", main.COMMANDS)
def test_a_command_is_a_function_of_its_name_and_says_what_the_list_says(name):
    command = main.load_command(name)
    assert command.name == name and command.help == main.COMMANDS[name]
    parameters = inspect.signature(command.callback).parameters
    json = set() if name in main.WITHOUT_RESULT else {"json"}  # is handed on beside the function
    assert {x.name for x in command.params} == {*parameters} | json


def test_a_mistyped_command_is_told_what_there_is():
    told = CliRunner().invoke(main.app, ["identfy"])
    assert told.exit_code == 2 and "'identify'" in told.output


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="XDG is Linux's")
def test_compiled_programs_go_into_the_cache_folder_that_the_user_names(tmp_path):
    names = ("DIFFFRIC_PROGRAMS", "JAX_COMPILATION_CACHE_DIR")
    code = (
        "import os\nfrom difffric.commands.main import prepare_jax\nprepare_jax()\n"
        f"print(*(os.environ[name] for name in {names}))"
    )
    rest = {k: x for k, x in os.environ.items() if k not in (*names, "XDG_CACHE_HOME")}
    for given, cache in (
        ({"XDG_CACHE_HOME": str(tmp_path)}, tmp_path),
        ({"HOME": str(tmp_path)}, tmp_path / ".cache"),
    ):
        done = subprocess.run(
            [sys.executable, "-c", code], env=rest | given, capture_output=True, text=True
        )
        own = cache / "difffric"
        assert done.stdout.split() == [str(own / "programs"), str(own / "jax")], done.stderr
