"""What the programs of extended models answer, and how little of it they compute."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import difffric as df
from difffric.diagnosis.data import prepare_data
from difffric.estimation import extended_model
from difffric.estimation.block_means import UnevenBlocks
from difffric.estimation.extended_model import ExtendedModel
from difffric.estimation.following import answer_by_program
from difffric.estimation.following.push_answer import PushAnswer
from difffric.estimation.stacked_data import RECORDINGS
from difffric.measurements.pushes import Pushes


def _make_slides(n: int) -> ExtendedModel:
    v = np.linspace(0.05, 0.5, n)
    slides = Pushes(release_velocity=v, sliding_distance=0.4 * v**2)
    rig = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8.0e5, b=1500.0, k_v=5.0)
    return prepare_data(rig, slides, None, np.full((n, 2), 1e-5)).task.model


def test_values_alone_are_those_that_come_with_derivatives():
    n = 40  # more than one batch of either program
    model = _make_slides(n)
    rng = np.random.default_rng(1)
    c = 0.01 * rng.normal(size=(n, len(model.coordinates.names)))
    c[:, 0] += np.log(0.141)
    index = rng.permutation(n)
    rows = np.eye(c.shape[1])[:3]
    values, both = (model.answers(index, c, given) for given in (rows[:0], rows))
    assert values.gram.shape == (n, 2, 1, 1)
    np.testing.assert_allclose(values.model[:, 1], both.model[:, 1], rtol=1e-13)
    np.testing.assert_allclose(values.residual, both.residual, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(values.gram[..., 0, 0], both.gram[..., -1, -1], rtol=1e-10)


class _Line(NamedTuple):
    """Stands for a path: what it reads is linear in time."""

    slope: jax.Array

    def read(self, t_force, t_position):
        return self.slope * t_force, 2 * self.slope * t_position


def test_instants_that_no_block_asks_for_are_not_read():
    chunk = answer_by_program.CHUNK
    e, used = 4 * chunk, chunk + 3
    t = np.linspace(1.0, 2.0, e)
    none = np.zeros(5)
    second = np.array([3, used, 7, 0, 0])
    blocks = UnevenBlocks(t, second - 1, second, none, none, none, np.asarray(5.0))
    two = jax.tree.map(lambda x: np.stack([x, x]), blocks)

    def read(slope):
        return answer_by_program._read_in_chunks(_Line(slope), two, two)

    slope = jnp.array([1.0, -3.0])
    (f, x), (df_, _) = jax.jvp(read, (slope,), (jnp.ones(2),))
    np.testing.assert_allclose(f[:, : used + 1], np.outer(slope, t[: used + 1]))
    np.testing.assert_allclose(x, 2 * f)
    np.testing.assert_allclose(df_[0], f[0])
    assert np.all(f[:, 2 * chunk :] == 0) and used < 2 * chunk


def test_a_push_that_takes_many_steps_is_followed_again_with_room_for_them(monkeypatch):
    long, asked = 3, []

    def answer(self, index, c, directions, keep_rows):
        asked.append((self.steps, index.tolist()))
        residual = np.repeat(c[:, :2, None], 5, axis=2)
        residual[(index == long) & (self.steps < extended_model.STEPS)] = np.nan
        return PushAnswer(residual.sum(axis=2)[..., None, None], c[:, :2] + self.steps, residual)

    monkeypatch.setattr(ExtendedModel, "_answer_in_batches", answer)
    model = replace(_make_slides(5), kind=RECORDINGS, directions=0)
    c = np.random.default_rng(2).normal(size=(6, len(model.coordinates.names)))
    index = np.array([0, long, 1, 2, long, 4])
    found = model.answers(index, c, np.zeros((0, c.shape[1])))
    few, most = extended_model.FEW_STEPS, extended_model.STEPS
    assert asked == [(few, index.tolist()), (most, [long, long])]
    assert np.all(np.isfinite(found.residual)) and np.all(np.isfinite(found.gram))
    steps = np.where(index == long, most, few)
    np.testing.assert_array_equal(found.model, c[:, :2] + steps[:, None])
    # Without such a push nobody waits for a second program.
    asked.clear()
    model.answers(index[[0, 2]], c[:2], np.zeros((0, c.shape[1])))
    assert asked == [(few, [0, 1])]
