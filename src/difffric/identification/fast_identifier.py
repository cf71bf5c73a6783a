"""mu_s of one push at once, for a loop that identifies while it controls: microseconds a push.

`invert` and `identify` answer in milliseconds, with every root, every reason and the calibration's
own errors. Here is the number alone, with the sensors' standard error.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difffric.compute.precision import require_float64
from difffric.compute.xla_options import in_one_piece
from difffric.errors import InputError
from difffric.identification.crossing import find_crossing
from difffric.identification.inversion import BRACKET
from difffric.rig.rig import Rig


class Instant(NamedTuple):
    """mu_s and its standard error; NaN where the readings give none."""

    mu_s: float
    standard_error: float
    mu_s_force: float
    mu_s_force_se: float
    mu_s_distance: float
    mu_s_distance_se: float


def identifier(
    rig: Rig,
    *,
    peak_force_se: float = np.nan,
    sliding_distance_se: float = np.nan,
    bracket: tuple[float, float] = BRACKET,
) -> Callable[..., Instant]:
    """A function of (velocity [m/s], peak_force [N], sliding_distance [m]), all Python floats,
    that gives the mu_s of that push on this rig: NaN for what was not measured.

    mu_s is the mean of the two estimates, weighted by the inverse squares of their standard
    errors, which come from those of the readings [N, m] by the exact slopes; one whose reading's
    error is not given does not count in it. Compiled once for all rigs of a kind. In such a loop
    set `jax.config.update("jax_cpu_enable_async_dispatch", False)`.

    Raises `InputError` for a rig with a stroke, where one distance may mean several mu_s
    (`invert` finds them all), and for one without a closed form.
    """
    require_float64()
    if rig.pusher.stroke is not None:
        raise InputError(
            "identifier: expected a rig without a stroke (the pusher stops at the first loss of "
            "contact); with one a distance may mean several mu_s: use invert"
        )
    if not rig.affine:
        raise InputError("identifier: expected a rig with a closed form; for others use invert")
    leaves, structure = jax.tree.flatten(rig)
    numbers = [float(leaf) for leaf in leaves]
    settings = (float(peak_force_se), float(sliding_distance_se), *map(float, bracket))
    program = _program(structure)
    always = np.array([np.nan, np.nan, np.nan, *settings, *numbers])

    def instant(velocity, peak_force=np.nan, sliding_distance=np.nan) -> Instant:
        given = always.copy()
        given[0], given[1], given[2] = velocity, peak_force, sliding_distance
        return Instant._make(np.asarray(program(given)).tolist())

    return instant


@lru_cache(maxsize=16)
def _program(structure):
    def one(rig, velocity, target, se, by_force, bracket):
        known = target > 0  # and not NaN; what is not is sought in one point, which takes no time
        bracket = bracket[0], jnp.where(known, bracket[1], bracket[0])
        root = find_crossing(
            rig, velocity, jnp.where(known, target, 1.0), by_force, bracket, by_force
        )
        good = known & root.solved & (root.slope != 0)
        mu_s = jnp.where(good, root.mu_s, jnp.nan)
        return mu_s, jnp.where(good, se / jnp.abs(jnp.where(good, root.slope, 1.0)), jnp.nan)

    def both(given):
        velocity, F_p, d, se_F, se_d, lower, upper = given[:7]
        rig = jax.tree.unflatten(structure, list(given[7:]))
        by_force = one(rig, velocity, F_p, se_F, True, (lower, upper))
        by_distance = one(rig, velocity, d, se_d, False, (lower, upper))
        weights = [jnp.where(se > 0, 1.0 / se**2, 0.0) for _, se in (by_force, by_distance)]
        total = weights[0] + weights[1]
        values = [jnp.where(jnp.isnan(mu_s), 0.0, mu_s) for mu_s, _ in (by_force, by_distance)]
        mean = (weights[0] * values[0] + weights[1] * values[1]) / total
        return jnp.stack([mean, jnp.sqrt(0.0 * mean + 1.0 / total), *by_force, *by_distance])

    return jax.jit(in_one_piece(both))
