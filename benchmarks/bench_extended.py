"""Laws that are not affine: F_p, d and their derivatives by mu_s, in a batch."""

from __future__ import annotations

import functools

import jax
import numpy as np
import pytest

import difffric as df
from benchmarks import contest, diffrax_push, model
from difffric.rig import parameters

GROUP = "3b. Laws that are not affine: a batch of one contact, per push"
OTHERS = tuple(contest.PUSH[name] for name in ("k", "b", "k_v", "m", "ratio"))
LAWS = {
    "Stribeck": ({"stribeck": {"v_s_m_per_s": 0.02}}, {"v_s": 0.02}),
    "contact hardening": ({"contact_hardening": {"exponent": 1.3}}, {"exponent": 1.3}),
}
OURS = {
    **{name: effects for name, (effects, _) in LAWS.items()},
    "waviness": {"friction_waviness": {"amplitude": 0.1, "wavelength_m": 1e-3, "phase_rad": 0.4}},
    "lagging pusher": {"pusher_lag": {"tau_s": 1e-3}},
    "rebound damping": {"rebound_damping": {"share": 0.3}},
    "low-pass": {"force_lowpass": {"tau_s": 1e-4}},
}


def _rig(mu_s=0.141):
    p = contest.PUSH
    return df.spring_damper_rig(
        mass=p["m"], mu_s=mu_s, k=p["k"], b=p["b"], mu_k_over_mu_s=p["ratio"], k_v=p["k_v"]
    )


def _batch(rig, integrator=None):
    def make(v, mu_s):
        rigs = parameters.with_values(rig, {"mu_s": mu_s})

        def call():
            found = df.observe_batch(rigs, v, integrator=integrator)
            by = found.peak_force_by["mu_s"], found.sliding_distance_by["mu_s"]
            return np.stack([found.peak_force, found.sliding_distance, *by])

        return call

    return make


def _diffrax(laws):
    def make(v, mu_s):
        compiled = jax.jit(
            jax.vmap(
                lambda v, mu_s: diffrax_push.with_derivative(v, mu_s, *OTHERS, **laws), out_axes=1
            )
        )
        return lambda: np.asarray(compiled(v, mu_s))

    return make


REFERENCE = "difffric, Stribeck"
# contender -> what makes its call, pushes, whose answer it is compared with
CONTENDERS = {
    **{
        f"difffric, {name}": (_batch(df.rig.extended(_rig(), effects)), 4096, None)
        for name, effects in OURS.items()
    },
    **{
        f"diffrax by hand, {name}": (_diffrax(laws), 2048, f"difffric, {name}")
        for name, (_, laws) in LAWS.items()
    },
    "difffric, all effects at once, at their null values": (
        _batch(df.rig.universal(_rig())), 1024, None,
    ),
    "difffric, the affine rig, integrated": (
        _batch(_rig(), df.simulation.RungeKutta()), 4096, None,
    ),
}  # fmt: skip


@functools.cache
def _made(contender, v, mu_s):
    return CONTENDERS[contender][0](np.array(v), np.array(mu_s))


@pytest.fixture(scope="module")
def points():
    """Pushes of one closing and one rebound: what the hand-written sequence of modes assumes."""
    rng = np.random.default_rng(model.SEED)
    return rng.uniform(2000.0, 5000.0, 4096) / 60e3, rng.uniform(0.12, 0.30, 4096)


@pytest.mark.benchmark(group=GROUP)
@pytest.mark.parametrize("contender", CONTENDERS)
def test_extended(benchmark, contender, points):
    make, n, other = CONTENDERS[contender]
    v, mu_s = (np.asarray(p)[:n] for p in points)
    reference = None
    if other is not None:
        reference = _made(other, tuple(v), tuple(mu_s))
    contest.race(
        benchmark,
        contender,
        make(v, mu_s),
        names=contest.ANSWERS,
        reference=reference,
        within=1e-2,
        points=n,
        rounds=5,
        iterations=1,
        is_reference=contender == REFERENCE,
    )
