"""Hidden effects: data from a simulator that shares no code with the library, from rough set-ups.
What is named, its size, and what it gains on pushes that nobody has fitted."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import difffric as df
from difffric import cause_search, diagnosis
from difffric.cli import app
from difffric.setup_file import read_setup
from tests.hidden import heldout, random_case, write
from tests.prediction import prediction_error


@lru_cache
def folder_of(name: str, tmp: Path) -> Path:
    return tmp / name


class Analysis:
    """A case on disk, its diagnosis, and that of pushes it has not seen."""

    def __init__(self, case, folder: Path):
        self.case = case
        self.path = write(case, folder)
        self.setup = read_setup(folder / "setup.toml")
        self.options = {"use_data_mass": len(case.masses) > 1}
        self.found = df.diagnose(self.setup, df.load(self.path), **self.options)
        self.folder = folder

    @property
    def named(self):
        """The set that the first cause stands for."""
        first = self.found.causes[0]
        return {first.id, *first.confusable_with}

    def error(self, setup):
        """Of a set-up, on further pushes of the same rig."""
        new = write(heldout(self.case), self.folder / "new")
        noise = self.case.noise.force, np.sqrt(2) * self.case.noise.position
        return prediction_error(setup, df.load(new), noise, **self.options)


# One effect at least of each component; strengths at which it is not to be missed.
HIDDEN = {
    "stribeck": dict(seed=2, strength=30, delta=1.0),
    "friction_waviness": dict(seed=3, strength=30),
    "rebound_damping": dict(seed=11, strength=30),
    "pusher_lag": dict(seed=5),
    "force_lowpass": dict(seed=6, strength=30),
    "channel_skew": dict(seed=7, strength=30),
    "probe_scale": dict(seed=2, strength=12, kind="table"),
    "initial_gap": dict(seed=3, kind="table", strength=20),
}


@pytest.mark.parametrize("effect", HIDDEN)
def test_a_hidden_effect_is_named_sized_and_gains_on_new_pushes(effect, tmp_path):
    options = dict(HIDDEN[effect])
    case = random_case(options.pop("seed"), effect, **options)
    one = Analysis(case, tmp_path)
    assert one.found.verdict in ("named", "ambiguous")
    assert effect in one.named
    assert len(one.found.causes) == 1
    if one.found.causes[0].id == effect and effect != "stribeck":
        for key, (value, error) in one.found.causes[0].parameters.items():
            away = value - case.effects[effect][key]
            if key == "phase_rad":
                away = (away + np.pi) % (2 * np.pi) - np.pi
            assert abs(away) < 4 * error
    gain = one.found.gain
    assert gain.after < gain.before
    before, after = one.error(df_setup(one.found.plain.rig)), one.error(one.found.setup)
    assert after < before and after < 1.1


def df_setup(rig):
    from difffric.setup_file import Setup

    return Setup(rig)
