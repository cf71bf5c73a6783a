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
def test_a_command_is_a_function_of_its_name_and_says_what_the_list_says(name):
    command = main.load_command(name)
    assert command.name == name and command.help == main.COMMANDS[name]
    parameters = inspect.signature(command.callback).parameters
    assert {x.name for x in command.params} == {*parameters}


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
