"""difffric as the benchmarks call it: F_p, d and their derivatives by mu_s as four rows."""

from __future__ import annotations

import functools
import importlib.util
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.contest import PUSH
from difffric.rig import parameters
from difffric.rig.rig import spring_damper_rig
from difffric.simulation import batch as batched
from difffric.simulation.observables import observe

SEED = 20240503


def rig(stroke=None):
    """The rig of the benchmarks."""
    laws = {"k": PUSH["k"], "b": PUSH["b"], "k_v": PUSH["k_v"], "mu_k_over_mu_s": PUSH["ratio"]}
    return spring_damper_rig(mass=PUSH["m"], mu_s=0.141, stroke=stroke, **laws)


def with_derivative(stroke=None, integrator=None):
    """A function of (v, mu_s): F_p, d, dF_p/dmu_s, dd/dmu_s. Not compiled."""
    plain = rig(stroke)

    def measured(v, mu_s):
        seen = observe(parameters.with_values(plain, {"mu_s": mu_s}), v, integrator)
        return seen.peak_force, seen.sliding_distance

    def function(v, mu_s):
        value, slope = jax.jvp(lambda m: measured(v, m), (mu_s,), (jnp.ones_like(mu_s),))
        return jnp.stack([*value, *_where_it_exists(value, slope)])

    return function


def _where_it_exists(value, slope):
    return [jnp.where(jnp.isnan(x), jnp.nan, y) for x, y in zip(value, slope, strict=True)]


def points(n):
    """n random speeds [m/s] and mu_s, over the paper's range."""
    rng = np.random.default_rng(SEED)
    return rng.uniform(500.0, 5000.0, n) / 60e3, rng.uniform(0.05, 0.30, n)


def batch(stroke=None, integrator=None):
    """`with_derivative` compiled for arrays: NumPy in, NumPy out, four rows."""
    one = with_derivative(stroke, integrator)
    # Four arrays: stacked within the program they would all be computed an element at a time.
    compiled = jax.jit(jax.vmap(lambda v, mu_s: tuple(one(v, mu_s))))
    return lambda v, mu_s: np.stack(compiled(v, mu_s))


def observe_batch(v, mu_s, stroke=None, threads=None):
    """A call of `observe_batch`, what a user has for many pushes: four rows."""
    rigs = parameters.with_values(rig(stroke), {"mu_s": mu_s})

    def call():
        found = batched.observe_batch(rigs, v, threads=threads)
        slopes = found.peak_force_by["mu_s"], found.sliding_distance_by["mu_s"]
        return found.peak_force, found.sliding_distance, *slopes

    return call


@functools.cache
def operations():
    """Floating-point operations of a push with its derivatives, as XLA counts its program."""
    function = jax.vmap(lambda v, mu_s: tuple(with_derivative()(v, mu_s)))
    numbers = np.ones(1024)
    counted: Any = jax.jit(function).lower(numbers, numbers).compile().cost_analysis()
    return counted["flops"] / len(numbers)


def diffrax_integrator():
    """difffric's own integrator for laws without a closed form; None where it is missing."""
    if importlib.util.find_spec("difffric.simulation.diffrax_reference") is None:
        return None
    from difffric.simulation.diffrax_reference import Diffrax

    return Diffrax()
