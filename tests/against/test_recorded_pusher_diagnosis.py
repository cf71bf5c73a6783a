"""Pushes by the simulator of the hidden cases, with a ramp and a ripple, their tips recorded: with
the motion nothing is missing, without it the ramp is, and mu_s is right both ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import difffric as df
from tests.against.test_recorded_pusher import MU_S, RIG
from tests.hidden import simulate
from tests.hidden.case import MM_MIN, Case, draw_pushes
from tests.hidden.simulate import friction_of

SCATTER = 0.02
EFFECTS = {
    "pusher_ramp": {"acceleration_m_per_s2": 5.0},
    "pusher_ripple": {"amplitude": 0.02, "period_m": 1e-3, "phase_rad": 0.3},
}
TIP_NOISE = 3e-7


@pytest.mark.slow
def test_a_recorded_tip_leaves_nothing_to_name_and_its_ramp_is_named_without_it(tmp_path):
    """The two slowest pushes are caught again, once and twice."""
    rng = np.random.default_rng([0, 77])
    pushes = draw_pushes(rng, {"A": MU_S}, SCATTER, list(MM_MIN * np.linspace(1000, 4500, 8)))
    case = Case(0, "recordings", RIG, {"A": MU_S}, SCATTER, pushes, effects=EFFECTS)
    data = df.load(simulate.write(case, tmp_path, TIP_NOISE))
    assert sorted(run.contacts for run in simulate.answers(case))[-2:] == [2, 3]
    setup, truth = df.read_setup(tmp_path / "setup.toml"), friction_of(case)

    recorded = df.diagnose(replace(setup, recorded_motion=True), data)
    assert recorded.verdict == "adequate"
    check_friction(recorded.plain.mu_s, recorded.plain.mu_s_se, truth)
    for name in ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m"):
        error = recorded.plain.standard_error(name)
        assert abs(recorded.plain.value(name) - RIG[name]) < 2 * error, name

    commanded = df.diagnose(setup, data)
    assert commanded.verdict == "named"
    assert "pusher_ramp" in {cause.id for cause in commanded.causes}
    check_friction(commanded.mu_s, commanded.mu_s_standard_error, truth)


def check_friction(mu_s, error, truth):
    """Within two standard errors of each push's own."""
    assert (np.abs(np.asarray(mu_s) - truth) < 2 * np.asarray(error)).all()
