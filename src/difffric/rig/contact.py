"""Contact laws: what the push tip does to the part. Equation (2)'s bracket stands here.

z = y - x is the compression [m], w = y' - x' its rate [m/s]. A law is written as two smooth
branches, because one smooth right-hand side a mode is what makes derivatives exact.
The effects below are laws around a law.
"""

from __future__ import annotations

import abc
from typing import ClassVar

from difffric.compute import arrays as xp
from difffric.compute.number_tree import NumberTree
from difffric.compute.smooth_extension import power
from difffric.rig.number import Number, Truth


class AbstractContact(NumberTree, abc.ABC):
    """A contact law: a force [N] that only pushes, zero without contact (z < 0).

    To add one, subclass, give it its parameters as fields (SI units) and `approach`;
    also `rebound` where it differs for w < 0. Both must be smooth beyond w = 0, increase
    with z, and `rebound` must vanish at z = `edge`: that is where contact is lost. Set
    `affine = True` only where both are affine in (z, w).
    """

    affine: ClassVar[bool] = False
    continues: ClassVar[bool] = False
    """whether both are smooth a little beyond z = 0, where a step may look for the event"""
    parts_early: ClassVar[bool] = False
    """whether a rebound may lose contact, and find it again, at z > 0"""

    @abc.abstractmethod
    def approach(self, z: Number, w: Number) -> Number:
        """Contact force [N] for z >= 0, w >= 0."""

    def rebound(self, z: Number, w: Number) -> Number:
        """Contact force [N] for z >= 0, w < 0."""
        return self.approach(z, w)

    def edge(self, w: Number) -> Number:
        """The compression [m] at which contact is lost in a rebound at w < 0; 0 for w >= 0."""
        return xp.zeros_like(w)

    @property
    def gap(self) -> Number:
        """How far the tip starts from the part [m]."""
        return 0.0

    @property
    def rough(self) -> Truth:
        """Whether the law may not be smooth at z = 0, as a power is not."""
        return xp.asarray(True)

    @property
    def damped(self) -> Truth:
        """Whether `edge` may lie beyond z = 0."""
        return xp.asarray(False)

    def __call__(self, z: Number, w: Number) -> Number:
        """The whole law: both branches and the loss of contact."""
        pushed = xp.where(w >= 0, self.approach(z, w), self.rebound(z, w))
        return xp.where(z >= self.edge(w), pushed, 0.0)


class UnilateralSpringDamper(AbstractContact):
    """`b max(y' - x', 0) + k max(y - x, 0)` of equation (2), in contact only: the damper
    acts on approach, the spring on compression, and the contact never pulls.
    """

    k: Number
    b: Number
    affine: ClassVar[bool] = True
    continues: ClassVar[bool] = True

    def approach(self, z: Number, w: Number) -> Number:
        return self.b * w + self.k * z

    def rebound(self, z: Number, w: Number) -> Number:
        return self.k * z

    @property
    def rough(self) -> Truth:
        return xp.asarray(False)


class AbstractContactEffect(AbstractContact):
    """A law around another one, `law`; what an effect does not override is that law's own."""

    law: AbstractContact

    @property
    def continues(self) -> bool:
        return self.law.continues

    @property
    def parts_early(self) -> bool:
        return self.law.parts_early

    def approach(self, z: Number, w: Number) -> Number:
        return self.law.approach(z, w)

    def rebound(self, z: Number, w: Number) -> Number:
        return self.law.rebound(z, w)

    def edge(self, w: Number) -> Number:
        return self.law.edge(w)

    @property
    def gap(self) -> Number:
        return self.law.gap

    @property
    def rough(self) -> Truth:
        return self.law.rough

    @property
    def damped(self) -> Truth:
        return self.law.damped


class ReboundDamping(AbstractContactEffect):
    """A loss on rebound of its own: `k z + b w` for w < 0, never below zero.

    b >= 0 [N s/m], beside the damper on approach, which it may exceed; null: 0.
    """

    law: AbstractContact
    b: Number = 0.0
    parts_early: ClassVar[bool] = True

    @property
    def affine(self) -> bool:
        return self.law.affine

    @property
    def damped(self) -> Truth:
        return xp.asarray(self.b) > 0

    def rebound(self, z: Number, w: Number) -> Number:
        return self.law.rebound(z, w) + self.b * w

    def edge(self, w: Number) -> Number:
        zero = xp.zeros_like(w)
        stiffness = self.law.rebound(zero + 1.0, zero) - self.law.rebound(zero, zero)
        return self.law.edge(w) - self.b * xp.minimum(w, 0.0) / stiffness


class Hardening(AbstractContactEffect):
    """A spring that stiffens: `k z_r (z / z_r)^n` in place of `k z` (Hertz: n = 1.5; Johnson,
    Contact Mechanics, Cambridge 1985, ch. 4).

    n >= 1; null: n = 1. z_r = 1e-4 m: there the forces of all n are equal.
    """

    law: AbstractContact
    exponent: Number = 1.0
    z_r: ClassVar[float] = 1e-4

    @property
    def rough(self) -> Truth:
        return xp.asarray(self.exponent != 1.0)

    def _soften(self, z: Number) -> Number:
        return self.z_r * power(z / self.z_r, self.exponent)

    def approach(self, z: Number, w: Number) -> Number:
        return self.law.approach(self._soften(z), w)

    def rebound(self, z: Number, w: Number) -> Number:
        return self.law.rebound(self._soften(z), w)

    def edge(self, w: Number) -> Number:
        return self.z_r * power(self.law.edge(w) / self.z_r, 1.0 / self.exponent)


class InitialGap(AbstractContactEffect):
    """The pusher starts a gap away and strikes the part; its stroke includes the gap.

    gap >= 0 [m]; null: 0.
    """

    law: AbstractContact
    gap: Number = 0.0
