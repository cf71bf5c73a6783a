"""The motion of an axis against brute force: F(t) in, position and derivatives out."""

from dataclasses import replace

import numpy as np
import pytest

from difffric.axis import simulate_axis
from difffric.axis.motion.stepped_motion import step_motion
from difffric.errors import InputError
from tests.reference.axis import Axis, follow, record
from tests.unit.axis.made import as_setup

SHORT = {"speeds": (0.1, 0.3), "travel": 0.05, "scatter": 0.0}
EFFECTS = {
    "friction_direction": (
        {"coulomb_share": 0.1, "viscous_share": -0.2},
        {"coulomb_share": 0.1, "viscous_share": -0.2},
    ),
    "cogging": (
        {"amplitude_N": 2.0, "period_m": 0.012, "phase_rad": 0.7},
        {"amplitude": 2.0, "period": 0.012, "phase": 0.7},
    ),
    "friction_strengthening": (
        {"amplitude": 0.1, "speed_m_per_s": 0.003},
        {"strength": 0.1, "strength_speed": 0.003},
    ),
    "stribeck": ({"v_s_m_per_s": 0.02}, {"v_s": 0.02}),
    "friction_waviness": (
        {"amplitude": 0.1, "wavelength_m": 0.02, "phase_rad": 0.2},
        {"waviness": 0.1, "wavelength": 0.02, "wave_phase": 0.2},
    ),
    "quadratic_drag": ({"c_N_s2_per_m2": 100.0}, {"drag": 100.0}),
}
"""Effect -> (its numbers in a set-up, the same in the reference)."""
PARAMETERS = {
    "mass_kg": "mass", "coulomb_N": "coulomb", "k_v_N_s_per_m": "k_v", "offset_N": "offset",
}  # fmt: skip


def draw(seed):
    """A random axis, some without viscous friction, some that hardly stick."""
    g = np.random.default_rng(seed)
    coulomb = g.uniform(3, 30)
    k_v = 0.0 if seed % 5 == 4 else g.uniform(5, 300)
    return Axis(g.uniform(2, 100), coulomb, coulomb * g.uniform(1, 1.4), k_v, g.uniform(-3, 3))


def solve(axis, made):
    """The reference's positions under the recorded force."""
    ones = np.ones(len(made.t))
    return follow(made.force, ones, made.t[1] - made.t[0], 0.0, 0.0, axis.numbers())[0]


@pytest.mark.parametrize("seed", range(5))
def test_positions_are_those_of_brute_force(seed):
    axis = draw(seed)
    made = record(axis, seed=seed, **SHORT)
    moved = simulate_axis(as_setup(axis), made.force, made.t)
    assert np.abs(moved.position - solve(axis, made)).max() < 1e-12
    assert {kind for kind, _ in moved.events} >= {"break-away"}


@pytest.mark.parametrize("name", PARAMETERS)
def test_derivatives_are_those_of_differences(name):
    axis = draw(1)
    made = record(axis, seed=1, **SHORT)
    moved = simulate_axis(as_setup(axis), made.force, made.t)
    value = getattr(axis, PARAMETERS[name])
    step = 1e-6 * value
    up, down = (
        solve(replace(axis, **{PARAMETERS[name]: value + way * step}), made) for way in (1, -1)
    )
    expected = (up - down) / (2 * step)
    scale = np.abs(expected).max()
    assert np.abs(moved.derivatives[name] - expected).max() < 1e-6 * scale


def test_steps_through_each_sample_agree_with_whole_runs():
    axis = draw(2)
    made = record(axis, seed=2, **SHORT)
    n = 700
    runs = simulate_axis(as_setup(axis), made.force[:n], made.t[:n])
    steps = step_motion(as_setup(axis), made.force[:n], made.t[:n], 0.0, 0.0)
    assert np.abs(runs.position - steps.position).max() < 1e-12
    assert [kind for kind, _ in runs.events] == [kind for kind, _ in steps.events]
    for name in PARAMETERS:
        scale = np.abs(runs.derivatives[name]).max()
        assert np.abs(runs.derivatives[name] - steps.derivatives[name]).max() < 1e-9 * scale


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_moves_the_axis_as_brute_force_says(effect):
    numbers, of_reference = EFFECTS[effect]
    axis = Axis(effects=of_reference)
    made = record(axis, seed=3, speeds=(0.2,), travel=0.03, scatter=0.0)
    setup = replace(as_setup(axis), effects={effect: numbers})
    moved = simulate_axis(setup, made.force, made.t)
    plain = simulate_axis(as_setup(axis), made.force, made.t)
    expected = solve(axis, made)
    assert np.abs(moved.position - expected).max() < 1e-9
    assert np.abs(plain.position - expected).max() > 1e-5


def test_a_late_drive_shifts_the_motion_in_time():
    axis = Axis()
    made = record(axis, seed=4, speeds=(0.2,), travel=0.03, scatter=0.0)
    late = replace(as_setup(axis), effects={"drive_delay": {"delay_s": 0.003}})
    force = np.where(made.t < 0.005, 0.0, made.force)
    moved, plain = (simulate_axis(x, force, made.t) for x in (late, as_setup(axis)))
    assert np.abs(moved.position[3:] - plain.position[:-3]).max() < 1e-12


def test_the_derivative_by_a_delay_is_that_of_differences():
    axis = Axis()
    made = record(axis, seed=4, speeds=(0.2,), travel=0.02, scatter=0.0)

    def move(delay):
        setup = replace(as_setup(axis), effects={"drive_delay": {"delay_s": delay}})
        return simulate_axis(setup, made.force, made.t)

    expected = (move(0.0024 + 1e-8).position - move(0.0024 - 1e-8).position) / 2e-8
    found = move(0.0024).derivatives["drive_delay.delay_s"]
    assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max()


def test_a_stuck_axis_stays_where_it_is():
    t = np.arange(100) * 1e-3
    moved = simulate_axis(as_setup(Axis(offset=0.0)), np.full(100, 23.9), t, position=0.2)
    assert np.all(moved.position == 0.2)
    assert moved.events == ()


@pytest.mark.parametrize(
    ("force", "time"), [([1.0], [0.0]), ([1.0, 2.0], [0.0, 0.0]), ([1.0, np.nan], [0.0, 1.0])]
)
def test_forces_that_are_none_are_refused(force, time):
    with pytest.raises(InputError, match="expected"):
        simulate_axis(as_setup(Axis()), force, time)
