"""Samples of a rig by another simulator are noise about the right model, in every block."""

from __future__ import annotations

import numpy as np
import pytest

import difffric as df
from difffric.diagnosis import start
from difffric.diagnosis.data import place_at, place_blocks, prepare_data
from difffric.estimation.extended_model import ExtendedModel
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.progress import silent
from difffric.rig.setup_toml import read_setup
from difffric.simulation.column_traces import follow_columns
from tests.hidden import random_case, write

TWICE, TURNING = 7, 13
"""The push that loses contact twice, and one whose damper lets go in the middle of a block."""


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """Mean squares of each push's force about the true model, in units of its noise: in blocks as
    the samples tell where they are short, and placed by the model."""
    case = random_case(100_087)
    recordings = df.load(write(case, tmp_path_factory.mktemp("case")))
    rig = df.spring_damper_rig(
        mass=case.rig["mass_kg"],
        mu_s=0.2,
        mu_k_over_mu_s=case.rig["mu_k_over_mu_s"],
        k=case.rig["k_N_per_m"],
        b=case.rig["b_N_s_per_m"],
        k_v=case.rig["k_v_N_s_per_m"],
        stroke=2e-3,
    )
    mu_s = np.array([push.mu_s for push in case.pushes])
    reduction = reduce_recordings(recordings)
    first = prepare_data(rig, reduction.pushes, reduction)
    at = place_at(first.task, rig, mu_s, case.scatter)

    def measure(data):
        pushes = data.task.model.pushes
        each = df.rig.parameters.with_stroke(rig, pushes.stroke)
        each = df.rig.parameters.with_values(each, {"mu_s": mu_s})
        traces, blocks = follow_columns(each, pushes.velocity, len(mu_s), 64), pushes.data[0]
        index = np.repeat(np.arange(len(mu_s)), blocks.t.shape[1])
        force = traces.read(index, blocks.t.ravel(), 0, 0)[0].reshape(blocks.t.shape)
        pick = np.take_along_axis
        means = 0.5 * (pick(force, blocks.first, 1) + pick(force, blocks.second, 1))
        r = blocks.y - means
        white = blocks.a * r - blocks.b * np.pad(r, ((0, 0), (1, 0)))[:, :-1]
        return (white**2).sum(axis=1) / data.task.counts[:, 0]

    return measure(first), measure(place_blocks(first, rig, at))


def test_a_contact_that_is_lost_for_the_first_time_ends_no_block_in_its_middle(left):
    assert left[0][TWICE] < 1.3


def test_blocks_placed_by_the_model_leave_noise_alone(left):
    before, after = left
    assert before[TURNING] > 1.6
    assert after.max() < 1.4 and np.median(after) == pytest.approx(1.0, abs=0.1)


def test_a_search_starts_from_blocks_that_its_plain_fit_places(tmp_path, monkeypatch):
    recordings = df.load(write(random_case(100_087), tmp_path))
    setup = read_setup(tmp_path / "setup.toml")
    monkeypatch.setattr(ExtendedModel, "compile", lambda self: None)
    given = []

    def fit(data, guess):
        given.append((data, guess))
        return guess

    monkeypatch.setattr(start, "start_plain_fit", fit)
    found = start.prepare_start(setup, recordings, silent).data.task
    ((before, at),) = given
    expected = place_blocks(before, start.strip_effects(setup)[0].rig, at).task
    assert np.all(found.counts == expected.counts)
    assert np.all(found.counts[:, 0] > before.task.counts[:, 0])
    assert np.all(found.counts[:, 1] == before.task.counts[:, 1])
