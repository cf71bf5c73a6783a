"""Long stick-slip: what only repeats itself is passed over, and no measurement changes."""

from __future__ import annotations

import numpy as np
import pytest

from difffric.compute.lanes import differentiate, repeat_while, spread
from difffric.identification.estimators import identify
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.columns import differentiate_columns, observe_columns
from difffric.simulation.events import Reason
from difffric.simulation.observables import observe, observe_segments
from difffric.simulation.segments import Push
from difffric.units import GRAVITY

N = 240
NAMES = ["mu_s", "k_N_per_m", "mass_kg", "b_N_s_per_m", "mu_k_over_mu_s"]


def draw_stick_slip(seed=0):
    """(rigs, speeds) that stick and slip up to some hundred times; where the stop comes in a slip
    the part leaves the tip."""
    rng = np.random.default_rng(seed)
    m, k = rng.uniform(1, 20, N), 10 ** rng.uniform(3, 5, N)
    mu_s, ratio = rng.uniform(0.1, 0.3, N), rng.uniform(0.5, 0.8, N)
    z_e, root = mu_s * ratio * m * GRAVITY / k, np.sqrt(k * m)
    b, k_v = rng.uniform(0, 0.03, N) * root, rng.uniform(0, 0.02, N) * root
    rigs = spring_damper_rig(
        mass=m, mu_s=mu_s, k=k, b=b, k_v=k_v, mu_k_over_mu_s=ratio,
        stroke=z_e * rng.uniform(20, 500, N),
    )  # fmt: skip
    return rigs, z_e * np.sqrt(k / m) * rng.uniform(0.1, 0.7, N)


def follow_every_cycle(rigs, v):
    """What is measured where no cycle is left out."""
    with np.errstate(all="ignore"):
        push = Push(rigs, v, ClosedForm())
        end = repeat_while(lambda s: ~s.over, lambda s, p: p.cycle(s)[0], push.start(), push)
        return spread(observe_segments(push, end), N)


def test_repeats_passed_over_change_neither_a_push_nor_its_derivatives():
    rigs, v = draw_stick_slip()
    every = parameters.values(rigs)
    exact, slopes = differentiate(
        lambda at: follow_every_cycle(
            parameters.with_values(rigs, dict(zip(NAMES, at, strict=True))), v
        ),
        [every[name] for name in NAMES],
        list(np.eye(len(NAMES))[:, :, None]),
    )
    seen, by = differentiate_columns(rigs, v, NAMES)
    some = (exact.reason == Reason.OK) & (exact.contacts == 1)
    assert some.sum() > 8
    for code in ("reason", "regime", "contacts", "kind"):
        np.testing.assert_array_equal(getattr(seen, code), getattr(exact, code))
    np.testing.assert_allclose(seen.peak_force, exact.peak_force, rtol=1e-14)
    np.testing.assert_allclose(seen.sliding_distance, exact.sliding_distance, rtol=1e-9)
    np.testing.assert_allclose(seen.duration, exact.duration, rtol=1e-12)
    np.testing.assert_allclose(seen.displacement, exact.displacement, rtol=1e-12)
    size = np.abs(by.sliding_distance[:, some]).max(axis=0)
    away = np.abs(by.sliding_distance - slopes.sliding_distance)[:, some]
    assert (away / size).max() < 1e-8


def slow_rig(**changes):
    """A push of 40 mm at 0.5 mm/s sticks and slips more than a thousand times."""
    given = {"mass": 18.9, "mu_s": 0.141, "k": 8e5, "b": 1500.0, "k_v": 5.0, "stroke": 0.04}
    return spring_damper_rig(**{**given, **changes})


def test_a_peak_that_is_decided_is_told_with_its_derivative():
    seen, by = differentiate_columns(slow_rig(), 5e-4, ["mu_s"])
    F_p, weight = float(seen.peak_force[0]), 18.9 * GRAVITY
    assert F_p == pytest.approx(0.141 * weight, rel=0.01)
    assert by.peak_force[0, 0] == pytest.approx(weight, rel=0.01)
    assert seen.reason[0] == Reason.RESTS_IN_CONTACT
    assert float(observe(slow_rig(), 5e-4).peak_force) == pytest.approx(F_p, rel=1e-14)


def test_a_swing_that_hardly_fades_leaves_only_its_distance_open():
    """It neither sticks nor is let go: after a thousand cycles d is not known, the peak is."""
    rig = slow_rig(mu_k_over_mu_s=0.9999, b=0.05, k_v=0.0, stroke=0.4)
    z_e = float(0.9999 * 0.141 * 18.9 * GRAVITY / 8e5)
    seen = observe_columns(rig, 0.5 * z_e * np.sqrt(8e5 / 18.9))
    assert seen.reason[0] == Reason.TOO_MANY_CYCLES and np.isnan(seen.sliding_distance[0])
    assert seen.peak_force[0] == pytest.approx(1.5 * 8e5 * z_e, rel=1e-3)


@pytest.mark.parametrize("metres", [0.04, 40.0, 4e4])
def test_the_cost_of_a_stroke_does_not_grow_with_its_length(metres):
    push = Push(slow_rig(stroke=np.full(1, metres)), np.full(1, 5e-4), ClosedForm())
    with np.errstate(all="ignore"):
        assert push.last_state().cycles[0] < 50


def test_peaks_of_long_strokes_are_identified():
    """At low speed the peak is the breakaway's force: mu_s = F_p / (m g)."""
    forces = np.array([26.2, 26.4, 26.1, 26.3, 26.2])
    pushes = Pushes(
        np.array([6, 10, 15, 20, 30]) / 6e4, forces, stroke=np.full(5, 0.04),
        peak_force_se=np.full(5, 0.1),
    )  # fmt: skip
    found = identify(slow_rig(stroke=None), pushes)
    np.testing.assert_allclose(found.values("mu_s_force"), forces / 18.9 / GRAVITY, rtol=0.02)
