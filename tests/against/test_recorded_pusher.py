"""A push driven by a recorded motion: against constant speed, and a ramp against the simulator of
the hidden cases, which shares no code with the library."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import difffric as df
from difffric.estimation.following.motion_errors import displace_push
from difffric.measurements.recorded_motion import MODES, PIECES
from difffric.rig import parameters
from difffric.rig.pusher import RecordedMotion
from difffric.simulation.stepping.integrator import RungeKutta
from tests.hidden import stepper
from tests.hidden.case import Case, Push
from tests.hidden.simulate import numbers

SPEED, STROKE, RAMP = 0.05, 2e-3, 5.0
RIG = {
    "mass_kg": 18.9,
    "mu_k_over_mu_s": 0.75,
    "k_v_N_s_per_m": 5.0,
    "k_N_per_m": 8.0e5,
    "b_N_s_per_m": 1500.0,
}
MU_S = 0.141
RIG_IN_FRONT = df.spring_damper_rig(
    mass=18.9, mu_s=MU_S, k=8.0e5, b=1500.0, k_v=5.0, mu_k_over_mu_s=0.75, stroke=STROKE
)


def motion_of(corners, rates, end):
    """A recorded motion of these pieces, padded as those of recordings."""
    padded, filled = np.full(PIECES + 1, np.inf), np.zeros((PIECES + 1, 3))
    padded[: len(corners)], filled[: len(corners)] = corners, rates
    return RecordedMotion(padded, filled, end)


def ramp_motion():
    """V = a t up to the speed, and on at that until the stroke is done."""
    corner = SPEED / RAMP
    end = STROKE / SPEED + 0.5 * corner
    return motion_of([0.0, corner], [[0.0, RAMP, 0.0], [SPEED, 0.0, 0.0]], end)


def follow_reference(**changes):
    """(F_p, d) by the independent simulator, the numbers of its rig changed."""
    rig = {name: changes.get(name, value) for name, value in RIG.items()}
    push = Push(SPEED, changes.get("mu_s", MU_S), 0, 0.0)
    effects = {"pusher_ramp": {"acceleration_m_per_s2": RAMP}}
    case = Case(0, "recordings", rig, {"A": MU_S}, 0.0, [push], effects=effects, stroke=STROKE)
    rows, others = numbers(case)
    run = stepper.follow(rows[0], others, np.zeros(0))
    return np.array([run.peak_force, run.sliding_distance])


def test_a_motion_that_is_linear_is_the_push_at_constant_speed():
    """To round-off with the same integrator, whatever its pieces; to the steps' tolerance of the
    closed form."""
    constant = df.observe(RIG_IN_FRONT, SPEED, RungeKutta())
    closed = df.observe(RIG_IN_FRONT, SPEED)
    end = STROKE / SPEED
    for pieces in (1, 12):
        starts = end / pieces * np.arange(pieces)
        motion = motion_of(starts, np.tile([SPEED, 0.0, 0.0], (pieces, 1)), end)
        found = df.observe(parameters.with_stroke(RIG_IN_FRONT, motion), SPEED)
        for name in ("peak_force", "sliding_distance"):
            exact = float(getattr(found, name))
            assert exact == pytest.approx(float(getattr(constant, name)), rel=5e-12)
            assert exact == pytest.approx(float(getattr(closed, name)), rel=1e-9)
        assert int(found.regime) == int(closed.regime)


def test_a_ramp_and_its_derivatives_are_those_of_the_independent_simulator():
    rig = parameters.with_stroke(RIG_IN_FRONT, ramp_motion())
    found = df.sensitivity(rig, SPEED)
    seen = found.observables
    exact = np.array([float(seen.peak_force), float(seen.sliding_distance)])
    np.testing.assert_allclose(exact, follow_reference(), rtol=1e-7)
    for name in ("mu_s", "k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m"):
        value = MU_S if name == "mu_s" else RIG[name]
        step = 1e-4 * value
        up, down = (follow_reference(**{name: value + x}) for x in (step, -step))
        slope = (up - down) / (2 * step)
        ours = np.array([float(found.peak_force[name]), float(found.sliding_distance[name])])
        np.testing.assert_allclose(ours, slope, rtol=1e-4, atol=0)


def test_a_motion_that_may_be_faster_displaces_force_and_position_as_a_faster_push_does():
    """Through release and rest; where a mode does nothing, nothing is displaced."""
    share, end = 1e-4, STROKE / SPEED
    motion = motion_of([0.0], [[SPEED, 0.0, 0.0]], end)
    rates = np.zeros((MODES, *motion.rates.shape))
    late: Any = np.zeros(MODES)
    rates[0, 0, 0], late[0] = share * SPEED, -share * end
    modes = RecordedMotion(np.tile(motion.corners, (MODES, 1)), rates, late)
    t = np.linspace(-0.005, 0.08, 200) + 1.7e-5
    found = displace_push(RIG_IN_FRONT, SPEED, motion, modes, t, t)
    faster, slower = (df.simulate(RIG_IN_FRONT, (1 + x) * SPEED) for x in (share, -share))
    ends = [np.asarray(one.segments.t)[np.isfinite(one.segments.t)] for one in (faster, slower)]
    beside = (np.abs(t[:, None] - np.concatenate(ends)) < 2 * share * end).any(axis=1)
    for ours, read in ((found.force, "force"), (found.position, "position")):
        theirs = 0.5 * (np.asarray(getattr(faster, read)(t)) - getattr(slower, read)(t))
        scale = np.abs(theirs).max()
        np.testing.assert_allclose(ours[~beside, 0], theirs[~beside], atol=1e-4 * scale)
        assert (ours[:, 1:] == 0).all()
