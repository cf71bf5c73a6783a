"""NumPy answers for pushes what JAX does, and finds each push's own mu_s again."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

import difffric as df
from difffric.compute import pytrees
from difffric.estimation import coordinates
from difffric.estimation.coordinates import layout
from difffric.estimation.descent import Model, first_point
from difffric.estimation.following.compiled_search import respond
from difffric.estimation.following.respond_in_columns import respond_in_columns
from difffric.estimation.push_friction import find_best_friction, find_push_friction
from difffric.estimation.stacked_data import slides_data, table_data, traces_data
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.rig import parameters
from difffric.rig.sensors import ForceSensor
from difffric.simulation.closed_form import ClosedForm
from tests.reference import data as reference

TRUE = reference.Rig(
    m=18.9, mu_s=0.141, ratio=0.75, k_v=8.0, k=8.0e5, b=1500.0, scatter=0.02, stroke=2e-3
)
RIG = df.spring_damper_rig(
    mass=TRUE.m, mu_s=0.13, k=7.5e5, b=1400.0, k_v=5.0, force_sensor=ForceSensor(range=5000.0)
)


@pytest.fixture(scope="module")
def pushes():
    return reference.make_pushes(TRUE, np.random.default_rng(11))[:6]


@pytest.fixture(scope="module")
def recordings(pushes):
    rng, made = np.random.default_rng(3), []
    for p in pushes:
        x = reference.record(p, rng)
        channels = [
            Channel.of(y, x.dt, x.start, unit) for y, unit in ((x.force, "N"), (x.position, "m"))
        ]
        made.append(Recording(p.velocity, *channels, stroke=p.stroke))
    return Recordings(tuple(made))


def stack(kind, pushes, recordings):
    if kind == "slides":
        v = np.linspace(0.02, 0.2, 6)
        d = v**2 / (2 * 0.1 * 9.8)
        d[1] = np.nan  # not measured: it has no residual
        return RIG, slides_data(RIG, df.Pushes(release_velocity=v, sliding_distance=d), 1e-4)
    if kind == "table":
        table = df.Pushes(**reference.measure(pushes, np.random.default_rng(12)))
        return table_data(parameters.with_stroke(RIG, TRUE.stroke), table, (0.5, 3e-7))
    reduction = reduce_recordings(recordings)
    every = len(coordinates.names(RIG))
    return traces_data(RIG, recordings, reduction.details, 400.0, every)


def spread_coordinates(rig, n):
    """Coordinates (n, K) about the rig's, of which some pushes differ in every one."""
    values = {**{k: float(v) for k, v in parameters.values(rig).items()}, coordinates.START: 0.0}
    c = np.array([float(coordinates.to_coordinate(x, values[x])) for x in coordinates.names(rig)])
    return (
        c + 0.03 * np.random.default_rng(5).normal(size=(n, len(c))) * (np.arange(n) > 2)[:, None]
    )


@pytest.mark.parametrize("kind", ["table", "slides", "recordings"])
def test_numpy_answers_what_jax_does(kind, pushes, recordings):
    """Rows of a recording are triangles: they are the same up to rounding in R' R."""
    rig, data = stack(kind, pushes, recordings)
    c = spread_coordinates(rig, data.n)
    own = pytrees.pick(data.pushes, slice(data.n))
    exact = jax.tree.map(np.asarray, respond(pytrees.as_arrays(rig), ClosedForm(), own, c))
    moving = list(range(c.shape[1]))
    found = respond_in_columns(rig, own, c, moving)
    np.testing.assert_allclose(found.model, exact.model, rtol=1e-12)
    halves = 1 if kind != "recordings" else 2
    A, B = (x.rows.reshape(data.n, halves, -1, c.shape[1] + 1) for x in (found, exact))
    gram, expected = (np.einsum("ncij,ncik->ncjk", x, x) for x in (A, B))
    size = np.sqrt(np.einsum("ncjj->ncj", expected))
    size = np.where(size > 0, size, 1.0)
    away = (gram - expected) / (size[..., None] * size[..., None, :])
    assert np.abs(away).max() < 1e-9
    part = respond_in_columns(rig, own, c, [0])
    np.testing.assert_allclose(
        np.einsum("nij,nij->nj", part.rows, part.rows)[:, [0, -1]],
        np.einsum("nij,nij->nj", exact.rows, exact.rows)[:, [0, -1]],
        rtol=1e-9,
    )


def test_each_push_finds_its_own_friction_and_the_best_of_its_branches(pushes, recordings):
    """From the wrong side too, to a small part of its standard error; a push that is asked for
    twice goes its two ways."""
    rig, data = stack("recordings", pushes, recordings)
    plan = layout(rig, (), (), ["A"] * data.n, {}, {}, {})
    exact = {"k_N_per_m": TRUE.k, "b_N_s_per_m": TRUE.b, "k_v_N_s_per_m": TRUE.k_v}
    fixed = plan.fixed.copy()
    for name, value in exact.items():
        fixed[:, coordinates.names(rig).index(name)] = coordinates.to_coordinate(name, value)
    model = Model(rig, ClosedForm(), replace(plan, fixed=fixed), 0.3, False)
    at = first_point(model, data, np.zeros(0))
    index = np.array([0, 3, 3])
    start = np.log([p.mu_s for p in (pushes[0], pushes[3], pushes[3])]) - np.log(0.13)
    found = find_push_friction(model, data, at, index, start + np.array([0.02, -0.02, 0.03]), 60)
    assert np.abs(found.s_eta[2] - found.s_eta[1]) < 1e-7
    np.testing.assert_allclose(np.exp(found.s_eta) * 0.13, np.exp(start) * 0.13, rtol=1e-3)
    trials = start + np.array([[-0.2], [0.01], [0.25]])
    best = find_best_friction(model, data, at, index, trials)
    np.testing.assert_allclose(best.cost, found.cost, rtol=1e-6)


def test_recordings_are_identified_without_jax():
    program = """
import sys
import difffric as df
examples = sys.argv[1]
df.identify(df.load_setup(examples + "/setup.toml"), df.load(examples + "/pushes.tdms"))
assert "jax" not in sys.modules
"""
    examples = Path(__file__).parents[3] / "examples"
    subprocess.run([sys.executable, "-c", program, str(examples)], check=True)
