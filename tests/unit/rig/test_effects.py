"""The catalogue of effects, one table for all: null limits, and the independent reference.

A new effect is tested as soon as it stands in `catalogue.CATALOGUE`, against the reference as soon
as `tests/reference` knows it.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difffric as df
from difffric.compute import pytrees
from difffric.errors import InputError
from difffric.rig import catalogue, parameters
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.events import Regime
from difffric.simulation.stepping.integrator import RungeKutta
from difffric.simulation.trajectory import simulate
from tests.effect_rigs import (
    BY,
    EVERY,
    GROUPS,
    NAMES,
    OPTIONS,
    STORED,
    answers,
    built,
    errors,
    laws_of,
    null_rows,
    rows_of,
    units,
)
from tests.reference import effects as reference
from tests.reference.effect_parameters import BASE, EFFECTS

PLAIN = spring_damper_rig(mass=12.0, mu_s=0.15, k=7e5, b=800.0, k_v=9.0, stroke=1.4e-3)
VANISHING = [catalogue.CATALOGUE[name] for name in EVERY]
SAMPLE = 10
"""Rigs per effect in the default run."""

U, Z, W, T, F = 0.03, 4e-5, 0.02, 3e-3, 70.0
BRANCHES = {  # component -> everything that a push asks of its law
    "friction": {
        "sliding": lambda law: law.sliding(U, F),
        "breakaway": lambda law: law.breakaway(F),
        "first_breakaway": lambda law: law.first_breakaway(F),
        "load before the edge": lambda law: law.load(F, 1e-3, False),
        "load": lambda law: law.load(F, 1e-3, True),
        "slope": lambda law: law.slope(F),
    },
    "contact": {
        "approach": lambda law: law.approach(Z, W),
        "rebound": lambda law: law.rebound(Z, -W),
        "edge": lambda law: law.edge(jnp.asarray(-W)),
        "gap": lambda law: law.gap,
    },
    "pusher": {
        "speed": lambda law: law.speed(U),
        "stop_time": lambda law: law.stop_time(U),
        "ramp_time": lambda law: law.ramp_time(U),
        "corner": lambda law: law.corner(U, 0),
        "lag": lambda law: law.lag(),
        "rise": lambda law: law.rise(T, U, 1),
        "fall": lambda law: law.fall(T, U),
        "ripple": lambda law: law.ripple(1e-3),
        "stops_at_release": lambda law: law.stops_at_release(),
    },
    "force_sensor": {
        "read": lambda law: law.read(F),
        "low": lambda law: law.low,
        "slowness": lambda law: law.slowness,
        "interval": lambda law: law.interval,
    },
    "probe": {
        "read": lambda law: law.read(2 * T),
        "threshold": lambda law: law.threshold,
        "delay": lambda law: law.delay,
    },
}


def vanishing(effect, size="null"):
    """The effect's keys with the first, its size, at null, and its shape as `size` says."""
    first, *shape = effect.keys
    return {first.name: first.null} | {key.name: getattr(key, size) for key in shape}


@pytest.mark.parametrize("effect", VANISHING, ids=lambda effect: effect.id)
@pytest.mark.parametrize("size", ["null", "typical"])
def test_at_null_the_law_is_the_one_within(effect, size):
    with_it = catalogue.extended(PLAIN, {effect.id: vanishing(effect, size)})
    inner, outer = (getattr(rig, effect.component) for rig in (PLAIN, with_it))
    assert type(outer) is effect.law and outer.law == inner
    for name, branch in BRANCHES[effect.component].items():
        if effect.id == "contact_hardening":  # lengths in units of z_r round once
            np.testing.assert_allclose(branch(outer), branch(inner), rtol=3e-16, err_msg=name)
        else:
            np.testing.assert_array_equal(branch(outer), branch(inner), name)


@pytest.mark.parametrize("effect", catalogue.CATALOGUE.values(), ids=lambda effect: effect.id)
def test_an_entry_is_whole(effect):
    assert catalogue.CATALOGUE[effect.id] is effect and effect.text
    assert effect.id in EFFECTS, "tests/reference does not know it"
    typical = catalogue.extended(PLAIN, {effect.id: {key.name: key.typical for key in effect.keys}})
    law = getattr(typical, effect.component)
    for key in effect.keys:
        assert key.lower <= key.typical <= key.upper and key.lower <= key.null <= key.upper
        if not key.fixed:
            assert getattr(law, key.field) == key.to_law(key.typical)
    assert set(effect.given) <= set(law.__dataclass_fields__)


def test_the_rig_with_all_effects_has_one_structure():
    """What a compiled program is kept by, whichever effects are on."""
    rig = catalogue.universal(PLAIN)
    kind = jax.tree.structure(pytrees.as_arrays(rig))
    for effect in VANISHING:
        names = {f"{effect.id}.{key.name}": key.typical for key in effect.keys if not key.fixed}
        new = parameters.with_values(rig, names)
        assert jax.tree.structure(pytrees.as_arrays(new)) == kind
        assert new != rig or not names


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"stribek": {}}, "no such effect: stribek; known: tilt, .*friction_ratio"),
        ({"stribeck": {"v_s": 0.1}}, r"\[effects.stribeck\]: no such key: v_s; known: v_s_m_per_s"),
        ({"tilt": {"share": 0.1}}, r"\[effects.tilt\]: no such key: share; known: alpha_rad"),
    ],
)
def test_refusals(asked, message):
    with pytest.raises(InputError, match=message):
        catalogue.extended(PLAIN, asked)


# Against the stored answers of the independent reference. How far they are off, relatively, where
# a push is long or its d short: what goes wrong early is amplified by every rebound.

VALUE, SLOPE = (1e-9, 1e-8), (1e-7, 1e-7)
"""Of F_p and d: what nine pushes in ten keep to."""

WORST_VALUE, WORST_SLOPE = (2e-9, 1e-7), (1e-5, 1e-5)


def weights_of(rows):
    """One direction a push, in which all its parameters change at once."""
    return np.random.default_rng(0).uniform(0.3, 1.0, (len(rows), 1, len(BY)))


def agree(rows, found, weights):
    """Hold answers against the stored ones; returns how far they are off."""
    went = STORED["regimes"][STORED["regime"][rows]]
    np.testing.assert_array_equal(
        np.array([regime.word for regime in Regime])[found.seen.regime], went
    )
    np.testing.assert_array_equal(found.seen.contacts, STORED["contacts"][rows])
    off = errors(rows, weights, found)
    for column, name in enumerate(("F_p", "d")):
        assert np.nanmax(off.values[:, column]) < WORST_VALUE[column], name
        assert np.nanmax(off.slopes[:, column]) < WORST_SLOPE[column], f"d{name}"
    return off


def mostly(off):
    """Nine pushes in ten are nearer than the worst."""
    for column, name in enumerate(("F_p", "d")):
        assert np.nanquantile(off.values[:, column], 0.9) < VALUE[column], name
        assert np.nanquantile(off.slopes[:, column], 0.9) < SLOPE[column], f"d{name}"


@pytest.fixture(scope="module")
def sample():
    """{group: (rows, answers, weights)} by one program, and what it compiled after its first call;
    `null` holds plain rigs."""
    rows = {group: rows_of(group, SAMPLE) for group in GROUPS if group != "presliding"}
    rows["null"] = rows_of("force_gain", SAMPLE)
    every = np.concatenate(list(rows.values()))
    numbers, weights = STORED["parameters"][every], weights_of(every)
    directions = weights @ units(every)
    numbers[-SAMPLE:], directions[-SAMPLE:, :, len(BASE) :] = null_rows(rows["null"]), 0.0
    with np.errstate(invalid="ignore"):
        found = answers(EVERY, numbers, directions, RungeKutta())
    parts, start = {}, 0
    for group, own in rows.items():
        at = slice(start, start + len(own))
        parts[group], start = (own, found.part(at), weights[at]), start + len(own)
    return parts, found.compiled


def test_one_program_serves_all_effects(sample):
    _, compiled = sample
    assert compiled == 0


@pytest.mark.parametrize("group", [group for group in GROUPS if group != "presliding"])
def test_agrees_with_the_reference(group, sample):
    agree(*sample[0][group])


def test_most_pushes_agree_more_closely(sample):
    groups = [part for name, part in sample[0].items() if name != "null"]
    parts = [errors(rows, weights, found) for rows, found, weights in groups]
    mostly(jax.tree.map(lambda *x: np.concatenate(x), *parts))


def test_all_effects_at_null_are_the_plain_rig(sample):
    rows, found, weights = sample[0]["null"]
    directions = weights @ units(rows)
    directions[:, :, len(BASE) :] = 0.0
    plain = answers((), null_rows(rows), directions, ClosedForm())
    for name in ("regime", "contacts", "reason", "stuck_first"):
        np.testing.assert_array_equal(getattr(found.seen, name), getattr(plain.seen, name), name)
    np.testing.assert_allclose(found.values, plain.values, rtol=1e-8)
    np.testing.assert_allclose(found.slopes, plain.slopes, rtol=1e-6)


@pytest.fixture(scope="module")
def bristles():
    """(answers, stored rows, weights, plain rigs): bristles have no null value. First pushes as
    stored, of those that take few steps, then soft and stiff bristles on plain rigs."""
    rows = rows_of("presliding")
    rows = rows[np.argsort(STORED["steps"][rows])][: 10 * SAMPLE : 20]
    plain = null_rows(rows_of("force_gain"))
    plain = plain[np.isinf(plain[:, NAMES.index("stroke_m")])][:3]
    plain[:, NAMES.index("mu_k_over_mu_s")] = 1.0
    numbers = [STORED["parameters"][rows]]
    for sigma_0 in (1e6, 2e7):
        rigs = plain.copy()
        rigs[:, NAMES.index("presliding.sigma_0_N_per_m")] = sigma_0
        rigs[:, NAMES.index("presliding.sigma_1_N_s_per_m")] = np.sqrt(sigma_0 * rigs[:, 0])
        numbers.append(rigs)
    weights = weights_of(rows)
    directions = np.concatenate([weights @ units(rows), np.zeros((6, 1, len(NAMES)))])
    found = answers(("presliding",), np.concatenate(numbers), directions, RungeKutta())
    return found, rows, weights, plain


def test_bristles_agree_with_the_reference(bristles):
    found, rows, weights, _ = bristles
    agree(rows, found.part(slice(len(rows))), weights)


def test_stiff_bristles_approach_the_plain_rig(bristles):
    found, _, _, plain = bristles
    exact = answers((), plain, np.zeros((3, 1, len(NAMES))), ClosedForm()).values
    soft, stiff = (np.abs(found.values[at] / exact - 1) for at in (slice(-6, -3), slice(-3, None)))
    there = ~np.isnan(exact) & (soft > 0)  # F_p = b v at t = 0 is the same with any bristles
    assert (stiff < soft / 3)[there].all() and np.nanmax(stiff) < 0.03


def traces_agree(ids, groups, tolerance):
    """Hold what the sensors read at any time against the reference, on each group's shortest push
    and on a plain one."""
    shares = np.sort(np.random.default_rng(2).uniform(-0.01, 1.1, 80))

    def read(numbers):
        rig, velocity = built(numbers, ids)
        push = simulate(rig, velocity, integrator=RungeKutta(looped=True))
        times = shares * push.stop_time
        return times, *push.read(times, times)

    rows = np.array(
        [rows_of(group)[np.argmin(STORED["steps"][rows_of(group)])] for group in groups]
    )
    numbers = STORED["parameters"][rows]
    if "presliding" not in ids:
        numbers = np.concatenate([numbers, null_rows(rows)])
    found = jax.jit(jax.vmap(read), compiler_options=OPTIONS)(numbers)
    for row, times, *channels in zip(numbers, *found, strict=True):
        exact = reference.traces(dict(zip(NAMES, row, strict=True)), np.asarray(times))
        for ours, theirs in zip(channels, exact, strict=True):
            size = np.max(np.abs(theirs))
            np.testing.assert_allclose(ours, theirs, atol=tolerance * size, rtol=0)


def test_traces_are_the_reference_s():
    ids = ("force_lowpass", "channel_skew")
    traces_agree(ids, ids, 1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("effect", catalogue.CATALOGUE)
def test_traces_with_each_effect_are_the_reference_s(effect):
    # Between steps the tip's travel behind a lag is known less well than the part's.
    traces_agree((effect,), (effect,), 1e-6 if effect == "pusher_lag" else 1e-7)


@pytest.mark.slow
def test_a_filter_behind_a_hardened_contact():
    """Its force is no polynomial of the time where the contact is first touched."""
    traces_agree(("contact_hardening", "force_lowpass"), ("contact_hardening",), 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_all_stored_pushes_and_all_their_derivatives(group):
    rows = rows_of(group)
    active = np.isfinite(STORED["d_peak_force"][rows]).any(axis=0)
    weights = np.broadcast_to(np.eye(len(BY))[active], (len(rows), active.sum(), len(BY)))
    directions = weights @ units(rows)
    ids = laws_of(group)
    found = answers(ids, STORED["parameters"][rows], directions, RungeKutta(), quick=False)
    mostly(agree(rows, found, weights))


def test_a_patch_that_begins_where_contact_is_lost_is_passed_with_it():
    """Slow enough, the part leaves where the tip stops: the patch's edge may lie just there."""
    rig = spring_damper_rig(mass=13.17, mu_s=0.144, k=2.887e6, b=5518.0, k_v=11.3, stroke=1e-3)

    def slid(amplitude, start):
        keys = {"amplitude": amplitude, "start_m": start}
        return df.simulate(df.rig.extended(rig, {"friction_patch": keys}), velocity=1 / 60)

    plain = df.simulate(rig, velocity=1 / 60)
    assert plain.regime == "released_at_stop"
    for start in (1e-3 * (1 - 1e-9), 1e-3, 1e-3 * (1 + 1e-9)):
        np.testing.assert_allclose(slid(0.0, start).sliding_distance, plain.sliding_distance)
        found, before = slid(0.2, start), slid(0.2, 1e-3 * (1 - 1e-6))
        np.testing.assert_allclose(found.sliding_distance, before.sliding_distance, rtol=1e-4)
