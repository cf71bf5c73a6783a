"""The mu_s beside a curve whose size is not known, in a rig whose answers are linear."""

from dataclasses import replace

import numpy as np

from difffric.diagnosis.inferred.curve_size import fit_to_size, measure_open
from difffric.diagnosis.inferred.friction import compute_friction_errors, find_friction
from difffric.estimation.ensembles import ensemble, ensemble_refits
from tests.unit.diagnosis.linear_rig import make_task, start

NAMES = ("level", *(f"bend {k}" for k in range(7)))
"""The curve's coefficients."""
CURVE = [*range(1, 1 + len(NAMES))]
SEEN, ALONG = 3000.0, 0.999
"""By how many units of noise a push's numbers change with log mu_s, and what share of that the
curve's level does: nearly one with mu_s."""
MU = 0.05
"""The log mu_s of every push; fits start at zero."""


def push(rng, n, coefficients, beyond=0.0):
    """The task of n pushes with such a friction and curve, with `beyond` in units of noise that no
    curve follows, and its fit where neither is there yet."""
    bends = rng.normal(size=(n, 2, len(NAMES) - 1))
    own = np.broadcast_to([[[1.0], [0.5]]], (n, 2, 1))
    slopes = SEEN * np.concatenate([own, own * [[1.0], [ALONG]], bends], axis=2)
    measured = np.einsum("nik,k->ni", slopes, [MU, *coefficients]) + rng.normal(size=(n, 2))
    measured += beyond * rng.choice([-1.0, 1.0], (n, 2))
    task = make_task(slopes, measured, NAMES)
    task = replace(task, prior=np.zeros(1 + len(NAMES)), estimate_scatter=False)
    at = replace(start(task, 1e-6), extra=(tuple(CURVE),))
    return task, ensemble.evaluate(task, at)


def test_intervals_beside_a_curve_hold_mu_s():
    """Whatever size it has, from what the noise hides to a tenth."""
    rng, held, off = np.random.default_rng(1), [], []
    for _ in range(60):
        size = 10 ** rng.uniform(-4.5, -1)
        task, at = push(rng, 20, rng.normal(0.0, size, len(NAMES)))
        friction, errors = fit_to_size(task, at, CURVE).friction
        held.append(np.mean(np.abs(friction - MU) < 1.96 * errors))
        off.append(np.mean(np.abs(friction - MU) / errors))
    assert 0.85 < np.mean(held)
    assert 0.3 < np.mean(off)  # and are no wider than they need be


def test_where_no_curve_is_there_mu_s_is_the_plain_one():
    task, at = push(np.random.default_rng(2), 20, np.zeros(len(NAMES)))
    plain = replace(at, extra=((),), gram=None, residual=None)
    plain = ensemble_refits.refit(replace(task, prior=None), plain, 6)
    friction, errors = fit_to_size(task, at, CURVE).friction
    few = compute_friction_errors(replace(task, prior=None), plain)
    assert np.abs(friction - find_friction(task, plain)).max() < 3 * few.max()
    assert (few <= errors).all() and errors.max() < 5 * few.max()


def test_what_no_curve_follows_does_not_drive_it_along_what_no_push_sees():
    """At thirty times the noise, and with none to be found."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        task, at = push(rng, 20, np.zeros(len(NAMES)), beyond=30.0)
        found = fit_to_size(task, at, CURVE)
        friction, errors = found.friction
        assert (np.abs(friction - MU) < 2 * errors).all() and np.abs(found.fits.c).max() < 0.01


def test_mu_s_is_open_by_the_whole_curve_where_its_fit_has_not_arrived():
    curve = np.array([0.0, -0.16, 0.08])
    assert measure_open("friction_speed", curve, arrived=False) == 0.16
    assert measure_open("friction_speed", curve, arrived=True) == 0.0
    assert np.isclose(measure_open("friction_place", curve, True) ** 2, np.mean(curve**2))
