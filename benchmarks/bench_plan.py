"""One plan: the fastest push that lands within 2.5 um with 99 %, among 16 speeds.

Beside it what one writes on `df.observe` without it: the stroke of each speed by
`scipy.optimize.brentq`, its probability from 2000 random pushes.
"""

from __future__ import annotations

import jax
import numpy as np
import pytest
from scipy.optimize import brentq

import difffric as df
from benchmarks import contest, model
from difffric.centering.planning import SPEEDS, WITHIN, Known, plan
from difffric.rig import parameters

REFERENCE = "difffric, plan"
RANDOM = "brentq on difffric's displacement, 2000 random pushes a speed"
MU_S, SPREAD, DRAWS = 0.141, 0.0212, 2000
TARGETS = {"20 um": 20e-6, "1 mm": 1e-3}


def _difffric(target):
    known = Known(model.rig(), df.centering.Belief.normal(MU_S, 0.015, scatter=0.015))

    def call():
        return [plan(known, target).next.probability]

    return call


def _random(target):
    rig = model.rig()

    def displaced(velocity, stroke, mu_s):
        there = parameters.with_stroke(parameters.with_values(rig, {"mu_s": mu_s}), stroke)
        return df.observe(there, velocity).displacement

    one, many = jax.jit(displaced), jax.jit(jax.vmap(displaced, (None, None, 0)))
    mu_s = MU_S * np.exp(SPREAD * np.random.default_rng(0).standard_normal(DRAWS))

    def call():
        found = []
        for v in SPEEDS:
            stroke = brentq(lambda S, v=v: float(one(v, S, MU_S)) - target, 1e-6, target + 1e-3)
            x = np.asarray(many(v, stroke, mu_s))
            found.append(np.mean(np.abs(x - target) < WITHIN))
        sure = [p for p in found if p >= 0.99]
        return [sure[-1] if sure else max(found)]

    return call


CONTENDERS = {REFERENCE: (_difffric, 20), RANDOM: (_random, 3)}


@pytest.mark.parametrize(
    "target",
    [pytest.param(t, marks=pytest.mark.benchmark(group=f"10. One plan, {t}")) for t in TARGETS],
)
@pytest.mark.parametrize("contender", CONTENDERS)
def test_plan(benchmark, contender, target):
    make, rounds = CONTENDERS[contender]
    contest.race(
        benchmark, contender, make(TARGETS[target]), names=["probability"],
        reference=_difffric(TARGETS[target]), within=0.01, rounds=rounds,
        is_reference=contender == REFERENCE,
    )  # fmt: skip
