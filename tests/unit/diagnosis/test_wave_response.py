"""What a wave of any length changes, made from a few lengths: for pushes whose answers add up what
happens at each place of their ways, it is exact but for the window."""

from __future__ import annotations

import numpy as np
import pytest

from difffric.diagnosis.background import wave_response
from difffric.diagnosis.background.columns.shape_columns import divide_turns, number_wave
from difffric.diagnosis.background.evidence import Evidence
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.following.push_answer import AnswerRows
from tests.unit.diagnosis.linear_rig import LinearModel

WAVE = "friction_waviness"
NAMES = (f"{WAVE}.amplitude", f"{WAVE}.wavelength_m", f"{WAVE}.phase_rad", "tilt.x")
N, PLACES = 10, 60
WAYS = np.geomspace(2e-3, 1.4e-2, N)
SINE, LENGTH, COSINE, TILT = range(1, 5)


class WavyRig(LinearModel):
    """Friction's waves count by what each place of a push's way makes of them."""

    places: np.ndarray
    """(n, P) [m]"""
    weights: np.ndarray
    """(n, 2, P) of the places"""

    def compute_waves(self, index, turns):
        """What a sine and a cosine of amplitude 1 change (2, N, 2)."""
        angle = 2 * np.pi * turns[:, None] * self.places[index]
        both = np.stack([np.sin(angle), np.cos(angle)])
        return np.einsum("swp,wkp->swk", both, self.weights[index])

    def answers(self, index, c, directions, keep_rows=False):
        """As `ExtendedModel.answers`; waves have no derivatives here."""
        index = np.asarray(index)
        long = np.where(c[:, LENGTH] > 0, c[:, LENGTH], 1.0)
        sine, cosine = self.compute_waves(index, 1.0 / long)
        slopes = self.slopes[index]
        at = 1e3 + np.einsum("nik,nk->ni", slopes[..., [0, TILT]], c[:, [0, TILT]])
        at = at + c[:, SINE, None] * sine + c[:, COSINE, None] * cosine
        rows = np.broadcast_to(directions, (len(c), *np.shape(directions)[-2:]))
        J = -np.einsum("nik,ndk->nid", slopes[..., [0, TILT]], rows[..., [0, TILT]])
        A = np.concatenate([J, (self.measured[index] - at)[:, :, None]], axis=2)
        return AnswerRows(A[:, :, None, :], at).compare(keep_rows)


def make_rig(seed: int, turns: float, amplitude: float) -> tuple[EnsembleTask, Fits, SmallEffects]:
    """A rig in which a wave of so many turns [1/m] is hidden, and where a fit of it begins."""
    rng = np.random.default_rng(seed)
    rig = WavyRig(rng.normal(size=(N, 2, 1 + len(NAMES))), np.zeros((N, 2)), NAMES)
    rig.places = WAYS[:, None] * rng.uniform(size=(N, PLACES))
    rig.weights = 10 * rng.normal(size=(N, 2, PLACES))
    sine, _ = rig.compute_waves(np.arange(N), np.full(N, turns))
    rig.measured = 1e3 + amplitude * sine + 0.5 * rng.normal(size=(N, 2))
    task = EnsembleTask(rig, (), np.zeros(N, int), counts=np.ones((N, 2)))  # type: ignore
    K, one = 1 + len(NAMES), np.ones(1)
    small = SmallEffects(("tilt",), (TILT,), one, 5 * one, np.zeros(K), np.zeros(K))
    at = Fits(
        ((),), np.zeros((1, K)), np.zeros((1, 1)), np.zeros((1, N)), np.array([0.1]),
        np.ones((1, 2)),
    )  # fmt: skip
    return task, ensemble.evaluate(task, small.free(at)), small


@pytest.mark.parametrize("seed", range(5))
def test_a_wave_of_any_length_is_made_from_those_of_a_few(seed):
    task, at, _ = make_rig(seed, 1e3, 0.0)
    turns = np.random.default_rng(seed).uniform(10.0, 5e3, 20)
    response = wave_response.sample_waves(task, at, WAVE, WAYS, 5e3)
    assert sum(map(len, response.rows)) < 1.5 * 5e3 * WAYS.sum() + 10 * N
    sine, cosine = (
        np.stack([task.model.compute_waves(np.arange(N), np.full(N, x))[k] for x in turns], axis=2)  # type: ignore
        for k in (0, 1)
    )
    found = response.compute_rows(turns)
    usual = np.sqrt((sine**2 + cosine**2).mean())
    assert found[..., 0::2] == pytest.approx(-sine, abs=0.02 * usual)
    assert found[..., 1::2] == pytest.approx(-cosine, abs=0.02 * usual)
    changes = response.compute_changes(turns)
    assert changes[0::2] == pytest.approx(np.moveaxis(sine, 2, 0) / 1e3, abs=2e-5 * usual)


@pytest.mark.parametrize(("seed", "turns"), list(enumerate([120.0, 333.0, 1e3, 2.71e3, 4.44e3])))
def test_a_wave_is_found_at_its_length_where_only_long_ways_tell_it_apart(seed, turns):
    task, at, small = make_rig(seed, turns, amplitude=0.05)
    response = wave_response.sample_waves(task, at, WAVE, WAYS, 5e3)
    found = Evidence(task, at, small, None)
    cells = divide_turns(WAYS)
    chosen = wave_response.choose_lengths(found, response, cells)
    assert ((cells[0] <= chosen) & (chosen <= cells[-1])).all()
    columns = wave_response.make_wave_columns(task, WAVE, response, chosen)
    compared = found.add_columns(columns)
    waves = [item for item in compared.items if item.effect == WAVE]
    gains = [compared.compare([item.columns]).gain[0] for item in waves]
    best = chosen[int(np.argmax(gains))]
    assert best == pytest.approx(turns, abs=0.25 / WAYS.max())
    _, length, _ = number_wave(task, WAVE)
    shape = waves[int(np.argmax(gains))].shape
    assert shape is not None and shape.points[0][length] == pytest.approx(1 / best)


@pytest.mark.parametrize("turns", [500.0, 1999.0, 4000.0])
def test_what_a_wave_explains_is_what_the_dense_normal_distribution_says(turns):
    task, at, small = make_rig(0, 2e3, amplitude=0.02)
    response = wave_response.sample_waves(task, at, WAVE, WAYS, 5e3)
    found = Evidence(task, at, small, None)
    V = found.excess * np.eye(2 * N)  # errors are as large as what is left says
    for i, own in enumerate(found.push):
        mine = slice(2 * i, 2 * i + 2)
        V[mine, mine] += found.likeliest_scatter**2 * np.outer(own, own)
    level, tilt, left = found.rows.reshape(2 * N, 3).T
    W = np.linalg.inv(V + np.outer(tilt, tilt))  # a background of unit size

    def compute_left(*columns: np.ndarray) -> float:
        X = np.column_stack([level, *columns])
        return float(left @ W @ (left - X @ np.linalg.solve(X.T @ W @ X, X.T @ W @ left)))

    wave = response.compute_rows(np.array([turns])).reshape(2 * N, 2).T
    gain = wave_response._compute_gains(found, response, np.array([turns]))
    expected = found.excess * (compute_left() - compute_left(*wave))
    assert gain[0] == pytest.approx(expected, rel=1e-6)


def test_a_wave_has_half_a_turn_within_the_longest_way_at_least():
    cells = divide_turns(WAYS)
    assert cells[0] == pytest.approx(0.5 / WAYS.max())
    assert (np.diff(cells) > 0).all()
