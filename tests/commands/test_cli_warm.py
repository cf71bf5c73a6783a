"""`difffric warm` makes what later runs find, once."""

from concurrent.futures import Future

import numpy as np
import pytest
from typer.testing import CliRunner

import difffric as df
from difffric.commands import main
from difffric.compute.program_cache import cache_program
from difffric.compute.programs import record, store
from difffric.compute.programs.private_folder import FOLDER
from difffric.errors import NumericalError
from difffric.studies import first_runs

RIG = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500.0, k_v=5.0, stroke=2e-3)


@cache_program
def double(x):
    return 2.0 * x


def fail(setup):
    raise NumericalError("no such push")


TASKS = {"doubling": lambda setup: double(np.ones(3)), "failing": fail}


class Here:
    """A pool of processes whose only process is this one."""

    def __init__(self, *_, **__):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def submit(self, function, *args):
        future = Future()
        future.set_result(function(*args))
        return future


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER, str(tmp_path / "programs"))
    monkeypatch.setattr(first_runs, "TASKS", TASKS)
    monkeypatch.setattr(first_runs, "ProcessPoolExecutor", Here)
    monkeypatch.setattr(double, "_ready", {})
    monkeypatch.setattr(record, "RECORDS", [])
    yield tmp_path / "programs"
    store.find_folder.cache_clear()


def test_a_second_run_finds_all_there_until_something_is_gone(folder):
    runs = []
    for _ in range(2):
        runs.append(CliRunner().invoke(main.app, ["warm", "--quiet"]))
        assert runs[-1].exit_code == 0, runs[-1].output
    assert "failing: no such push" in runs[0].output and "compiled" in runs[0].output
    assert "1 programs" in runs[1].output and "all there" in runs[1].output
    setups = [df.Setup(RIG)]
    assert {name for name, *_ in first_runs.make_programs(setups)} == TASKS.keys()
    assert list(first_runs.make_programs(setups)) == []
    (made,) = first_runs.list_made(setups)
    assert made.name.endswith("double") and made.size > 0
    for path in folder.glob(f"*/{made.key}*"):
        path.unlink()
    assert len(list(first_runs.make_programs(setups))) == 2


def test_without_a_store_there_is_nothing_to_warm(monkeypatch):
    monkeypatch.delenv(FOLDER, raising=False)
    with pytest.raises(df.InputError, match=FOLDER):
        list(first_runs.make_programs([df.Setup(RIG)]))


def test_the_simulated_pushes_are_some_that_every_command_takes():
    setup = df.Setup(RIG)
    table, recordings = first_runs.make_table(setup), first_runs.make_recordings(setup)
    assert len(table) == len(recordings) == 12
    assert np.isfinite(table.peak_force).all() and np.isfinite(table.sliding_distance).all()
    peak = [push.force.samples.max() for push in recordings if push.force is not None]
    assert np.allclose(peak, table.peak_force, rtol=0.2)
