"""Optimistix's Levenberg-Marquardt method with the ends that a model with jumps needs."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import optimistix as optx

from difffric.compute.arrow import Arrow

_STEP = 1e-7
"""A step smaller than this in every coordinate is none."""
_REFUSALS = 10
"""Refused steps in a row after which a search has arrived."""


class LevenbergMarquardt(optx.LevenbergMarquardt):
    """Optimistix's, which also stops after `args` steps, and where it would go on for nothing:
    at an optimum to rounding, whose next step is none, and at a jump of the model, where step
    after step is refused."""

    def __init__(self):
        super().__init__(rtol=1e-8, atol=1e-7, linear_solver=Arrow())  # pyright: ignore

    def terminate(self, fn, y, args, options, state, tags):
        stop, result = super().terminate(fn, y, args, options, state, tags)
        refused = state.num_steps_since_acceptance >= _REFUSALS
        step = jax.tree.map(
            lambda new, old: jnp.max(jnp.abs(new - old), initial=0.0), state.y_eval, y
        )
        nothing = (jnp.max(jnp.stack(jax.tree.leaves(step))) < _STEP) & (state.num_steps > 0)
        return stop | refused | nothing | (state.num_steps >= args), result
