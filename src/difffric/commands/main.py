"""The command line: each command prints tables for a person and leaves its answer in --out.

A command is a function of its own name in the module of its own name, and is imported when it is
called: to show what commands there are takes a tenth of the time that jax alone needs to start.
"""

from __future__ import annotations

import gc
import importlib
import os
import sys
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from difffric.commands.layout.json_output import add_json_option
from difffric.commands.running import durations, last_error, versions
from difffric.commands.running.interruption import COMMAND
from difffric.compute.programs import private_folder
from difffric.errors import DifffricError, InputError

COMMANDS = {
    "init": "Write a first, commented setup.toml; k and b are guessed from measured pushes.",
    "check": "Show how measured pushes were read, what is missing, and what a fit could determine.",
    "fit": "Calibrate a rig or an axis on measured data; write the calibrated set-up.",
    "identify": "Find the friction of each push or stretch with a calibrated set-up; or of a whole "
    "fleet, given a folder or a pattern of files.",
    "diagnose": "Find what the simulation gets wrong, name the cause, write the extended set-up; "
    "or compare the rigs of a fleet, given a folder or a pattern of files.",
    "monitor": "Watch a machine over its pushes; raise an alarm (exit status 3) when it changes.",
    "plan": "Plan the push that brings a part to its target; say how likely it lands there.",
    "ring": "Find the offset of a ring from the axis, and its direction, from probe readings.",
    "centre": "Centre rings on a simulated machine with hidden friction; compare other ways.",
    "export": "Write mu_s from F_p and d as C code for a controller, with a stated error.",
    "acquire": "Record pushes from a card, real or simulated, into pushes.tdms; identify them.",
    "simulate": "Simulate one push: F_p, d, regime, derivatives; or the motion of an axis.",
    "family": "Compute F_p and d over speed and mu_s, and the fits (3) and (5) of the paper.",
    "warm": "Compile what the commands need for a set-up, so that their first run starts at once.",
    "report-bug": "Print what a report of a fault needs: the versions and the last error.",
    "paper": "Analyse the measurements of the paper: its tables and figures, and the model's.",
}
"""Each command, and what `--help` says it does."""

FOLDERS = {"check": "first_steps.", "init": "first_steps.", "report-bug": "running."}
"""Where those lie that do not lie beside this module."""

WITHOUT_RESULT = ("init", "report-bug", "warm")
"""Those that write no result.json."""

_GARBAGE = 100_000
"""Objects made between two collections of garbage: what is imported and compiled stays to the end,
and to look through it each 700 objects takes a tenth of a short command."""

UsageError: Any = typer.BadParameter.__base__
"""Typer brings its own copy of click, whose base of all wrong uses has no public name."""

_LIKE_ALL: dict[str, Any] = {"add_completion": False, "pretty_exceptions_enable": False}


class LazyGroup(TyperGroup):
    """Commands of which only the one that is called is imported."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take the arguments apart; show a command's help before any of them is converted, as what
        converts them (pydantic) takes longer to load than all that the help needs."""
        if args[:1] == ["--version"]:
            typer.echo("\n".join(versions.list_versions()))
            ctx.exit()
        if args[1:2] == ["--help"] and args[0] in COMMANDS:
            command = load_command(args[0])
            with typer.Context(command, info_name=args[0], parent=ctx) as own:
                typer.echo(command.get_help(own), color=own.color)
                own.exit()
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Return the called command's name, the command itself, and its own arguments."""
        name, listed, rest = super().resolve_command(ctx, args)
        prepare_jax()
        return name, listed if name is None else load_command(name), rest


def load_command(name: str) -> Any:
    """Import a command's module and return the command with its options."""
    own = name.replace("-", "_")
    module = importlib.import_module(f"difffric.commands.{FOLDERS.get(name, '')}{own}")
    function = getattr(module, own)
    alone = typer.Typer(**_LIKE_ALL)
    alone.command(name, help=COMMANDS[name])(function)
    command = typer.main.get_command(alone)
    if name not in WITHOUT_RESULT:
        add_json_option(command)
    return command


def _list_only() -> None:
    """What stands for a command in the list of all, where its options are not needed."""


app = typer.Typer(
    cls=LazyGroup,
    no_args_is_help=True,
    help="Measure friction and calibrate its model. Start with: difffric init DATA",
    **_LIKE_ALL,
)
for _name, _help in COMMANDS.items():
    app.command(_name, help=_help)(_list_only)


@app.callback()
def begin(
    version: Annotated[
        bool, typer.Option("--version", help="the versions that matter in a report of a fault")
    ] = False,
) -> None:
    """Differentiable identification of sliding friction."""


def main() -> None:
    """Run the command that the arguments name.

    Bad input is one clear line on standard error and exit status 2, never a traceback; so is what
    nobody expected, with status 1, and its traceback is kept for `report-bug`. Ctrl-C ends with
    status 130.
    """
    gc.set_threshold(_GARBAGE)
    words = sys.argv[1:]
    COMMAND.begin(words)
    with COMMAND.watch():
        sys.exit(_run(words))


def _run(words: list[str]) -> int:
    """Run a command line, and return its exit status."""
    try:
        return app(standalone_mode=False) or 0
    except UsageError as error:
        if not words:  # the help
            error.show()
            return 2
        text = " ".join(error.format_message().split()).rstrip(".")
        return _fail(f"{text}; --help says what is expected", 2)
    except typer.Abort:
        return _fail("aborted", 1)
    except InputError as error:
        return _fail(str(error), 2)
    except DifffricError as error:
        last_error.keep_error(error, words)
        return _fail(str(error), 1)
    except Exception as error:
        kept = last_error.keep_error(error, words)
        said = " ".join(str(error).split())
        do = "`difffric report-bug` puts together what a report needs" if kept else "please report"
        where = last_error.find_place(error)
        return _fail(f"a fault of difffric, {type(error).__name__} at {where}: {said}; {do}", 1)


def _fail(words: str, status: int) -> int:
    sys.stderr.write(f"difffric: {words}\n")
    return status


def prepare_jax() -> None:
    """Set 64 bits, and keep compiled programs in the user's cache folder between runs."""
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    # Several threads wait for each other in loops: a matrix of 250 is inverted 50 times as slowly
    # where another process is busy, and hardly sooner where none is.
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # Equinox's error callbacks would keep programs out of the cache; failures come as NaN and
    # with a reason here.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    # Here, as help needs no folder and would wait for the import.
    import platformdirs

    cache = platformdirs.user_cache_path("difffric", appauthor=False)
    os.environ.setdefault("DIFFFRIC_PROGRAMS", str(cache / "programs"))
    os.environ.setdefault(durations.CACHE, str(cache))
    folder = Path(os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache / "jax")))
    if folder.name and private_folder.make_private(folder):
        private_folder.sweep(folder)
    elif os.environ.pop("JAX_COMPILATION_CACHE_DIR"):
        sys.stderr.write(f"difffric: {folder}: {private_folder.REFUSED}: JAX's cache is not used\n")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    # What comes of numbers at the edge of all floats is told in words, or null with a reason.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    # An entry that another process is just writing: the program is compiled here.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")
    # One small program at a time: handing it to another thread costs more than running it.
    os.environ.setdefault("JAX_CPU_ENABLE_ASYNC_DISPATCH", "0")


if __name__ == "__main__":
    main()
