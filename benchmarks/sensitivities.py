"""The sensitivities of 14 recordings to every number of every effect, at their null values.

    python -m benchmarks.sensitivities

One compiled program gives force and position at 2000 instants of each of 14 pushes, and their
exact derivatives by the rig's parameters and by all the effects' numbers.
"""

from __future__ import annotations

import os
import sys
import time

os.environ["JAX_ENABLE_X64"] = "1"
os.environ.pop("JAX_COMPILATION_CACHE_DIR", None)
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import jax.numpy as jnp
import numpy as np

import difffric as df
from difffric.compute import pytrees
from difffric.rig import catalogue, parameters
from difffric.simulation.segments import Push
from difffric.simulation.trajectory import Trajectory

SAMPLES = 2000
STRIDES = 96
BASE = ("mu_s", "mu_k_over_mu_s", "k_v_N_s_per_m", "k_N_per_m", "b_N_s_per_m")


def sensitivities(rig):
    """A function of velocities (n,) and times (n, samples): force and position, and their
    derivatives by `BASE` and by the numbers of all effects the rig has."""
    plain = {name: parameters.values(rig)[name] for name in BASE}
    names = catalogue.parameter_names(rig)
    numbers = {name: catalogue.where(name)[0](rig) for name in names}

    def readings(point, velocity, times):
        base, extra = point
        at = catalogue.with_numbers(parameters.with_values(rig, base), extra)
        push = Push.of(at, velocity)
        trajectory = Trajectory.of(pytrees.as_arrays(push), strides=STRIDES)
        return trajectory.read(times, times)

    def both(velocity, times):
        point = jax.tree.map(lambda x: jnp.asarray(x, float), (plain, numbers))
        value = readings(point, velocity, times)
        return value, jax.jacfwd(lambda p: readings(p, velocity, times))(point)

    return jax.jit(lambda v, t: jax.lax.map(lambda a: both(*a), (v, t))), len(BASE) + len(names)


def main():
    rig = df.rig.universal(df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500.0, k_v=5.0))
    velocity = jnp.repeat(jnp.array([10.0, 20, 30, 40, 50, 60, 80]) * 1e-3, 2)
    times = jnp.linspace(0.0, 0.1, SAMPLES) * jnp.ones((14, 1))
    program, columns = sensitivities(rig)
    start = time.perf_counter()
    compiled = program.lower(velocity, times).compile()
    first = time.perf_counter() - start
    found = []
    for _ in range(5):
        start = time.perf_counter()
        out = jax.block_until_ready(compiled(velocity, times))
        found.append(time.perf_counter() - start)
    finite = all(np.isfinite(x).all() for x in jax.tree.leaves(out))
    print(f"14 pushes of {SAMPLES} samples, {columns} derivatives: {np.median(found):.3g} s warm, ")
    print(f"compiled in {first:.3g} s; all finite: {finite}")


if __name__ == "__main__":
    sys.exit(main())
