"""F_p, d and their derivatives against some 600 pushes solved to 40 digits by independent code.

`tests/reference/cases.json` is made by `python -m tests.reference.make_cases` (mpmath), which
shares nothing with the library.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difffric.compute.pytrees import pick, replicate
from difffric.rig import parameters
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.columns import VELOCITY, differentiate_columns
from difffric.simulation.events import Reason, Regime
from difffric.simulation.observables import observe
from difffric.simulation.sensitivities import Sensitivity, sensitivity

FILE = json.loads((Path(__file__).parents[1] / "reference" / "cases.json").read_text())
CASES = FILE["cases"]
KEYS = {
    "mass": "mass_kg",
    "mu_s": "mu_s",
    "mu_k_over_mu_s": "mu_k_over_mu_s",
    "k_v": "k_v_N_s_per_m",
    "k": "k_N_per_m",
    "b": "b_N_s_per_m",
}


QUANTITIES = {
    "peak_force": ("F_p_N", "peak_force_N"),
    "sliding_distance": ("d_m", "sliding_distance_m"),
}


def natural_scale(case, name):
    """What a parameter is measured in: itself; where it is zero (b, k_v), sqrt(k m)."""
    return case[name] or np.sqrt(case["k_N_per_m"] * case["mass_kg"])


def rigs(cases):
    """The cases' rigs in one, to be vmapped over; no stroke where no case has one."""
    columns = {ours: jnp.array([c[theirs] for c in cases]) for ours, theirs in KEYS.items()}
    strokes = [c["stroke_m"] for c in cases]
    stroke = None if set(strokes) == {None} else jnp.array([s or jnp.inf for s in strokes])
    return spring_damper_rig(**columns, stroke=stroke), velocities(cases)


def velocities(cases):
    return jnp.array([c["velocity_m_per_s"] for c in cases])


def solve_by_numpy(rig, velocity):
    """The pushes' sensitivities by columns of plain NumPy."""
    rig, velocity = jax.tree.map(np.asarray, (rig, velocity))
    names = [*parameters.names(rig), VELOCITY]
    seen, by = differentiate_columns(rig, velocity, names)
    columns = (dict(zip(names, x, strict=True)) for x in (by.peak_force, by.sliding_distance))
    return Sensitivity(seen, *columns)


@pytest.fixture(scope="module", params=["jax", "numpy"])
def ours(request):
    """Every case's observables and derivatives: without strokes by the one-contact program, with
    strokes by the general one."""
    solve: Any = solve_by_numpy
    if request.param == "jax":
        solve = eqx.filter_jit(eqx.filter_vmap(lambda rig, v: sensitivity(rig, v)))
    found = [None] * len(CASES)
    for stroked in (False, True):
        which = [i for i, c in enumerate(CASES) if (c["stroke_m"] is not None) == stroked]
        answer = jax.tree.map(np.asarray, solve(*rigs([CASES[i] for i in which])))
        for row, i in enumerate(which):
            found[i] = jax.tree.map(lambda leaf, row=row: leaf[row], answer)
    return found


def test_the_cases_cover_every_regime():
    assert len(CASES) >= 300
    classes = {(c["regime"], c["stuck_first"]) for c in CASES}
    assert {r for r, _ in classes} == {regime.word for regime in Regime}
    for regime in ("pushed_to_rest", "released_by_rebound", "released_at_stop"):
        assert {(regime, True), (regime, False)} <= classes
    assert set(range(1, 9)) <= {c["contacts"] for c in CASES}
    overdamped = [c for c in CASES if (c["b_N_s_per_m"] + c["k_v_N_s_per_m"]) ** 2
                  > 4 * c["k_N_per_m"] * c["mass_kg"]]  # fmt: skip
    assert len(overdamped) >= 30
    assert sum(c["k_v_N_s_per_m"] == 0 for c in CASES) >= 20


def test_regimes_agree(ours):
    for case, found in zip(CASES, ours, strict=True):
        seen = found.observables
        got = (Regime(int(seen.regime)).word, bool(seen.stuck_first), int(seen.contacts))
        assert got == (case["regime"], case["stuck_first"], case["contacts"]), case


def test_peak_force_to_1e_10(ours):
    worst = max(
        abs(found.observables.peak_force / case["F_p_N"] - 1)
        for case, found in zip(CASES, ours, strict=True)
    )
    assert worst < 1e-10


def test_sliding_distance_to_1e_9(ours):
    for case, found in zip(CASES, ours, strict=True):
        d = found.observables.sliding_distance
        if case["d_m"] is None:
            assert np.isnan(d) and int(found.observables.reason) != 0
        elif not case.get("near_edge"):
            assert abs(d / case["d_m"] - 1) < 1e-9, case


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_derivatives_to_1e_8(ours, quantity):
    value, key = QUANTITIES[quantity]
    for case, found in zip(CASES, ours, strict=True):
        reference = case["derivatives"][key]
        if reference is None or case.get("near_edge"):
            continue
        for name, exact in reference.items():
            got = float(getattr(found, quantity)[name])
            if name == "b_N_s_per_m" and case[name] == 0 and case["regime"] == "no_motion":
                # The force b v at touch has a kink in b at b = 0: ours is the physical side,
                # F_p = k s + b v.
                assert got == pytest.approx(case["velocity_m_per_s"], rel=1e-12)
                continue
            # Relative; what changes the quantity by less than 1e-9 per unit relative change is
            # the noise of what cancels.
            noise = 1e-9 * case[value] / natural_scale(case, name)
            assert abs(got - exact) <= 1e-8 * abs(exact) + noise, (name, got, exact, case)


def test_near_an_edge_the_answer_stays_right_on_its_side(ours):
    near = [(c, f) for c, f in zip(CASES, ours, strict=True) if c.get("near_edge")]
    assert len(near) >= 20
    for case, found in near:
        if case["d_m"] is None:
            continue
        d = float(found.observables.sliding_distance)
        assert abs(d / case["d_m"] - 1) < 1e-9 / min(1.0, case["margin"] / 1e-3)


def test_second_derivatives_to_1e_6():
    cases = [c for c in CASES if "d2_dmu_s2" in c]
    assert len(cases) >= 15

    def both(rig, v, mu_s):
        rig = eqx.tree_at(lambda r: r.friction.mu_s, rig, mu_s)
        seen = observe(rig, v)
        return jnp.stack([seen.peak_force, seen.sliding_distance])

    twice = jax.jacfwd(jax.jacfwd(both, argnums=2), argnums=2)
    for stroked in (False, True):
        some = [c for c in cases if (c["stroke_m"] is not None) == stroked]
        rig, v = rigs(some)
        got = np.asarray(eqx.filter_jit(eqx.filter_vmap(twice))(rig, v, rig.friction.mu_s))
        for case, (F2, d2) in zip(some, got, strict=True):
            exact = case["d2_dmu_s2"]
            assert abs(F2 - exact["peak_force_N"]) <= 1e-6 * abs(exact["peak_force_N"]) + 1e-9
            if exact["sliding_distance_m"] is not None:
                assert abs(d2 / exact["sliding_distance_m"] - 1) < 1e-6, case


def test_more_than_16_contacts_is_an_answer_that_says_so():
    cases = FILE["too_many_contacts"]
    rig, v = rigs(cases)
    seen = eqx.filter_jit(eqx.filter_vmap(observe))(rig, v)
    assert np.all(np.asarray(seen.reason) == Reason.TOO_MANY_CONTACTS)
    assert np.isnan(seen.peak_force).all() and np.isnan(seen.sliding_distance).all()


def test_one_push_alone_is_the_same_push_in_a_batch():
    some = [c for c in CASES if c["stroke_m"] is not None][:5]
    rig, v = rigs(some)
    rig = replicate(rig, len(some))
    batch = eqx.filter_jit(eqx.filter_vmap(observe))(rig, v)
    for i in range(len(some)):
        alone = eqx.filter_jit(observe)(pick(rig, i), v[i])
        assert float(alone.peak_force) == pytest.approx(float(batch.peak_force[i]), rel=1e-14)
