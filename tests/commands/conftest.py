"""What the tests of commands share."""

import sys

import pytest

from difffric.commands import main


@pytest.fixture
def run(monkeypatch, capfd):
    """A command line, in this process: exit status and what it said."""
    monkeypatch.setattr(main, "prepare_jax", lambda: None)  # tests/conftest.py has done it

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["difffric", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main.main()
        return int(stop.value.code or 0), *capfd.readouterr()

    return run
