"""`--json`: what result.json holds on standard output, and nothing else there."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Annotated, Any

import typer

_ASKED: ContextVar[bool] = ContextVar("json asked for", default=False)
"""Set by each command line that is read; it reaches what prints without a parameter in between."""


def add_json_option(command: Any) -> None:
    """Give a command that writes a result.json the option `--json`."""
    alone = typer.Typer(add_completion=False)
    alone.command()(_take_json)
    command.params += typer.main.get_command(alone).params


def _keep(value: bool) -> None:
    _ASKED.set(value)


def _take_json(
    json: Annotated[
        bool,
        typer.Option(
            "--json",
            callback=_keep,
            expose_value=False,
            help="print what result.json holds, and nothing else",
        ),
    ] = False,
) -> None:
    """Stand for the command that the option is given to."""


def is_json_asked() -> bool:
    """Whether the command that runs is to print its answer as JSON."""
    return _ASKED.get()
