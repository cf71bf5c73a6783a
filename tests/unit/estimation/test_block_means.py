"""Means over blocks are what a model reads at two instants, wherever its force bends."""

from __future__ import annotations

import numpy as np

import difffric as df
from difffric.estimation.block_means import make_uneven
from difffric.measurements.noise import Noise
from difffric.measurements.recordings import Channel
from difffric.simulation.column_traces import find_bends, follow_columns
from difffric.units import GRAVITY

# Stiff, and with so much damping that the force bends by 80 kN/s where the part turns.
RIG = df.spring_damper_rig(
    mass=22.7, mu_s=0.2, mu_k_over_mu_s=0.75, k=2.6e6, b=4400.0, k_v=10.7, stroke=2e-3
)
DT, END, LONGEST = 1e-4, 0.12, 1e-3
NOISE = Noise(0.2, 0.0)
TURN, RELEASE = 2, 3


def make_blocks(v, bends):
    """(blocks, traces) of one push at v [m/s] without noise."""
    traces = follow_columns(RIG, np.array([v]), 1, 64)
    t = -0.02 + DT * np.arange(round((END + 0.02) / DT))
    y = traces.read(np.zeros(len(t), int), t, 0, 0)[0]
    channel = Channel.of(y, DT, t[0], "N")
    stop, release = 2e-3 / v, traces.starts[0, RELEASE]
    given = (0.0, stop, release), (0.0, stop), 0.1, END, LONGEST
    return make_uneven(channel, NOISE, *given, bends), traces


def measure_misses(v, bends):
    """How far the model's means are from those of its own samples, in units of their noise."""
    blocks, traces = make_blocks(v, bends)
    force = traces.read(np.zeros(len(blocks.t), int), blocks.t, 0, 0)[0]
    return blocks.a * (blocks.y - 0.5 * (force[blocks.first] + force[blocks.second]))


def test_the_mean_of_two_points_is_that_of_the_samples_where_no_block_reaches_over_a_bend():
    speeds, missed = np.linspace(0.044, 0.052, 5), []
    for v, (times, by) in zip(speeds, find_bends(RIG, speeds, len(speeds)), strict=True):
        assert np.abs(measure_misses(v, times[np.abs(by) > 100.0])).max() < 0.1
        missed.append(np.abs(measure_misses(v, ())).max())
    assert max(missed) > 3.0


def test_no_block_reaches_over_a_bend_and_few_are_short():
    v = 0.08
    turn = follow_columns(RIG, np.array([v]), 1, 64).starts[0, TURN]
    with_it, without = (make_blocks(v, bends)[0] for bends in ((turn,), ()))
    first, last = with_it.t[with_it.first], with_it.t[with_it.second]
    single = with_it.first == with_it.second
    assert not np.any(~single & (first < turn) & (last > turn))
    assert single[np.abs(first - turn) < 4 * DT].all()
    assert with_it.samples == without.samples
    assert len(without.y) < len(with_it.y) <= len(without.y) + 12


def test_the_force_bends_where_the_part_turns_by_what_the_damper_lets_go():
    """As the tip's speed falls below the part's, b (V - u)' is lost, and k_v (V - u)' begins."""
    v = 0.08
    ((times, by),) = find_bends(RIG, np.array([v]), 1)
    traces = follow_columns(RIG, np.array([v]), 1, 64)
    turn = traces.starts[0, TURN]
    force = float(traces.read(np.array([0]), np.array([turn]), 0, 0)[0][0])
    friction = 0.2 * 0.75 * 22.7 * GRAVITY
    acceleration = (force - friction) / 22.7  # the part's; the tip has none
    lost = (4400.0 - 10.7) * acceleration
    np.testing.assert_allclose(by[np.argmin(np.abs(times - turn))], lost, rtol=1e-2)
