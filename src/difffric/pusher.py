"""Pushers: how the push tip travels."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class ConstantSpeed(eqx.Module):
    """y = v t up to the stroke [m], then the tip stands at once.

    `stroke=None` is the paper's silent case: the tip stands at the first loss of contact.
    An infinite stroke says the same in a batch that mixes both.
    """

    stroke: Float[Array, ""] | float | None = None

    def stop_time(self, velocity):
        """Time [s] at which the stroke ends; infinite without one."""
        return jnp.inf if self.stroke is None else self.stroke / velocity

    def stops_at_release(self):
        """Whether the tip stands at the first loss of contact."""
        return True if self.stroke is None else jnp.isinf(self.stroke)
