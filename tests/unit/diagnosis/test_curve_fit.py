"""Something outside the catalogue beside small effects: a curve is fitted in place of causes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.hidden import friction_of, random_case, with_nuisances
from tests.unit.diagnosis.analysis import Analysis


@pytest.mark.slow
def test_what_is_outside_the_catalogue_is_located_beside_a_background(tmp_path):
    """Friction that rises with the speed by 1 %: a Stribeck curve, a ripple, a waviness and a patch
    had left 1.2 times the noise, nothing was told, and mu_s was 1 % off in every push."""
    seed = 1_800_000
    case = random_case(seed, "friction_rise", change=0.03)
    case = with_nuisances(case, np.random.default_rng([seed, 5]), share=0.0035)
    found = Analysis(case, tmp_path, 0.005).found
    assert found.verdict == "unexplained" and found.causes == ()
    assert found.location is not None and found.location.form == "friction_speed"
    # No F_p or d shows by how much static friction grew in the rest before a push.
    seen = {name: x for name, x in case.nuisances.items() if name != "static_dwell"}
    had = friction_of(replace(case, nuisances=seen))
    away = np.abs(np.array(found.mu_s) - had)
    assert np.sqrt(np.mean((away / had) ** 2)) < 0.005
    assert (away < 3 * np.array(found.mu_s_standard_error)).all()
    rise = case.outsider["friction_rise"]
    x, curve = found.location.x, found.location.correction
    # Up to a constant, which is one with mu_k / mu_s, and a slope, which is one with k_v.
    true = rise["share"] * np.tanh(x / rise["speed"])
    A = np.stack([np.ones_like(x), x], axis=1)
    left = [y - A @ np.linalg.lstsq(A, y, rcond=None)[0] for y in (true, curve)]
    assert np.linalg.norm(left[1] - left[0]) < 0.5 * np.linalg.norm(left[0])
