"""Contact laws: what the push tip does to the part. Equation (2)'s bracket stands here.

z = y - x is the compression [m], w = y' - x' its rate [m/s]. A law is written as two smooth
branches, because one smooth right-hand side a mode is what makes derivatives exact.
"""

from __future__ import annotations

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class AbstractContact(eqx.Module):
    """A contact law: a force [N] that only pushes, zero without contact (z < 0).

    To add one, subclass, give it its parameters as fields (SI units) and `approach`;
    also `rebound` where it differs for w < 0. Both must be smooth beyond w = 0, increase
    with z, and `rebound` must vanish at z = 0: that is where contact is lost. Set
    `affine = True` only where both are affine in (z, w).
    """

    affine: ClassVar[bool] = False

    @abc.abstractmethod
    def approach(self, z: Float[Array, ""], w: Float[Array, ""]) -> Float[Array, ""]:
        """Contact force [N] for z >= 0, w >= 0."""

    def rebound(self, z: Float[Array, ""], w: Float[Array, ""]) -> Float[Array, ""]:
        """Contact force [N] for z >= 0, w < 0."""
        return self.approach(z, w)

    def __call__(self, z, w):
        """The whole law: both branches and the loss of contact."""
        pushed = jnp.where(w >= 0, self.approach(z, w), self.rebound(z, w))
        return jnp.where(z >= 0, pushed, 0.0)


class UnilateralSpringDamper(AbstractContact):
    """`b max(y' - x', 0) + k max(y - x, 0)` of equation (2), in contact only: the damper
    acts on approach, the spring on compression, and the contact never pulls.
    """

    k: Float[Array, ""] | float
    b: Float[Array, ""] | float
    affine: ClassVar[bool] = True

    def approach(self, z, w):
        return self.b * w + self.k * z

    def rebound(self, z, w):
        return self.k * z
