"""The rows that a push adds to a fit: measured less model, and its derivatives."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difffric as df
from difffric.compute import pytrees
from difffric.estimation import coordinates
from difffric.estimation.residuals import Grid, TracePush
from difffric.estimation.stacked_data import table_data
from difffric.rig import parameters
from difffric.rig.sensors import ForceSensor
from difffric.simulation.closed_form import ClosedForm
from tests.reference import data as reference

TRUE = reference.Rig(
    m=18.9, mu_s=0.141, ratio=0.75, k_v=8.0, k=8.0e5, b=1500.0, scatter=0.02, stroke=2e-3
)
RIG = df.spring_damper_rig(
    mass=TRUE.m, mu_s=TRUE.mu_s, k=TRUE.k, b=TRUE.b, k_v=5.0, force_sensor=ForceSensor(range=5000.0)
)


@pytest.fixture(scope="module")
def table():
    pushes = reference.make_pushes(TRUE, np.random.default_rng(11))
    return df.Pushes(**reference.measure(pushes, np.random.default_rng(12)))


def test_the_rows_of_a_table_are_measured_minus_model_and_its_derivatives(table):
    """Against `sensitivity`, which a 60-digit reference has checked."""
    from difffric.simulation.sensitivities import sensitivity

    rig, data = table_data(parameters.with_stroke(RIG, TRUE.stroke), table, (0.5, 3e-7))
    every = coordinates.names(rig)
    values = {k: float(v) for k, v in parameters.values(rig).items()}
    c = jnp.array([float(coordinates.to_coordinate(x, values.get(x, 0.0))) for x in every])
    respond = jax.jit(lambda push: push.respond(pytrees.as_arrays(rig), ClosedForm(), c).rows)
    for i in (0, 5):
        rows = np.asarray(respond(jax.tree.map(lambda a, i=i: a[i], data.pushes)))
        point = sensitivity(rig, table.velocity[i])
        assert rows[0, -1] == pytest.approx(
            table.peak_force[i] - float(point.observables.peak_force)
        )
        for j, name in enumerate(every[:-1]):
            slope = coordinates.slope(name, values[name])
            for row, by in ((0, point.peak_force), (1, point.sliding_distance)):
                assert rows[row, j] == pytest.approx(-float(by[name]) * slope, rel=1e-9, abs=1e-15)


def test_the_triangle_of_a_recording_keeps_its_normal_equations(monkeypatch):
    """R' R = [J r]' [J r], and block means agree with the mean over their samples."""
    from difffric.estimation import residuals

    rig = pytrees.as_arrays(parameters.with_stroke(RIG, 2e-3))
    size, dt = 4, 5e-5
    fine = dt * (np.arange(3000) + 0.5)
    trajectory = df.simulate(rig, 0.05)
    F, x, _ = (np.asarray(part) for part in trajectory.evaluate(fine))
    t = fine.reshape(-1, size).mean(axis=1)
    means = [y.reshape(-1, size).mean(axis=1) for y in (F, x)]
    jumps = np.array([0.0, 0.04, *np.asarray(trajectory.segments.t)])
    keep = (np.abs(t[:, None] - jumps) > 2 * size * dt).all(axis=1).astype(float)
    zero, before = np.zeros_like(t), np.zeros(len(t), int)
    curve = np.asarray((1 - 1 / size**2) / 24)
    force, position = (
        Grid(jnp.asarray(t), jnp.asarray(y), jnp.asarray(a), zero, before, curve)
        for y, a in zip(means, (keep, np.ones_like(t)), strict=True)
    )
    push = TracePush(jnp.asarray(0.05), jnp.asarray(2e-3), force, position)
    every = coordinates.names(rig)
    values = {k: float(v) for k, v in parameters.values(rig).items()}
    c = jnp.array([float(coordinates.to_coordinate(n, values.get(n, 0.0))) for n in every])
    K = len(every)
    rows = np.asarray(jax.jit(lambda c: push.respond(rig, ClosedForm(), c).rows)(c))
    assert np.abs(rows[: K + 1, -1]).max() < 1e-3 * np.sqrt(keep.sum())  # N
    assert np.abs(rows[K + 1 :, -1]).max() < 2e-9 * np.sqrt(len(t))  # m
    kept = {}
    monkeypatch.setattr(
        residuals, "_factorise", lambda J, r: kept.setdefault(len(kept), jnp.column_stack([J, r]))
    )

    def keep_factored(c):
        push.respond(rig, ClosedForm(), c)
        return dict(kept)

    for i, whole in jax.jit(keep_factored)(c).items():
        R, whole = rows[i * (K + 1) : (i + 1) * (K + 1)], np.asarray(whole)
        scale = np.sqrt(np.diag(whole.T @ whole))
        outer = np.outer(scale, scale)
        np.testing.assert_allclose(R.T @ R / outer, whole.T @ whole / outer, atol=1e-11)
