"""Friction laws: what the rails do to the part. Equation (1) stands here.

The effects below are laws around a law: each changes what it is about and hands on the rest.
"""

from __future__ import annotations

import abc
from math import inf, pi
from typing import Any, ClassVar

from difffric.compute import arrays as xp
from difffric.compute.elementary_functions import sin_cos
from difffric.compute.number_tree import NumberTree
from difffric.compute.smooth_extension import power
from difffric.rig.number import Number, Truth


class AbstractFriction(NumberTree, abc.ABC):
    """A friction law.

    To add one, subclass, give it its parameters as fields (SI units) and the first two methods
    below; each must be smooth. Set `affine = True` only where `sliding` is affine in `u`:
    the closed form then serves it, otherwise it is integrated. The other methods say how the
    rails differ from level and even ones, and may stay as they are.
    """

    affine: ClassVar[bool] = False
    uneven: ClassVar[bool] = False
    """whether the load depends on the position, or the first breakaway on what was before"""

    continues: ClassVar[bool] = False
    """whether `sliding` is smooth a little beyond u = 0, where a step may look for the halt"""
    bends_smoothly: ClassVar[bool] = False
    """whether the speed alone bends it, smoothly, in functions of `compute.arrays`: such a law can
    be stepped through without JAX"""

    @abc.abstractmethod
    def sliding(self, u: Number, F_N: Number) -> Number:
        """Friction force [N] on a part that slides at speed u > 0 [m/s] under F_N [N]."""

    @abc.abstractmethod
    def breakaway(self, F_N: Number) -> Number:
        """F_S, the force [N] at which a part at rest starts to slide."""

    def first_breakaway(self, F_N: Number) -> Number:
        """F_S of a part that has rested since before the push [N]."""
        return self.breakaway(F_N)

    def load(self, weight: Number, x: Number, beyond: Truth) -> Number:
        """Normal force [N] at the position x [m] under a weight [N].

        `beyond`: whether the part is past `edge`, where the load may jump.
        """
        return weight

    def slope(self, weight: Number) -> Number:
        """What gravity itself holds against the push [N]."""
        return 0.0

    @property
    def edge(self) -> Number:
        """The position at which the load jumps [m]."""
        return inf


class ViscousCoulomb(AbstractFriction):
    """Equation (1): `mu_k F_N + k_v v` while sliding; at rest equal to the applied force
    up to `F_S = mu_s F_N`.

    `mu_k = mu_k_over_mu_s * mu_s` follows mu_s; the paper takes 0.75 throughout.
    """

    mu_s: Number
    mu_k_over_mu_s: Number = 0.75
    k_v: Number = 0.0
    affine: ClassVar[bool] = True
    continues: ClassVar[bool] = True
    bends_smoothly: ClassVar[bool] = True

    @property
    def mu_k(self) -> Number:
        """Coefficient of sliding friction."""
        return self.mu_k_over_mu_s * self.mu_s

    def sliding(self, u: Number, F_N: Number) -> Number:
        return self.mu_k * F_N + self.k_v * u

    def breakaway(self, F_N: Number) -> Number:
        return self.mu_s * F_N


class AbstractFrictionEffect(AbstractFriction):
    """A law around another one, `law`; what an effect does not override is that law's own."""

    law: AbstractFriction

    @property
    def affine(self) -> bool:
        """An effect that bends its law sets this to False."""
        return self.law.affine

    @property
    def uneven(self) -> bool:
        return self.law.uneven

    @property
    def continues(self) -> bool:
        return self.law.continues

    @property
    def bends_smoothly(self) -> bool:
        """An effect that bends its law by more than the speed sets this to False."""
        return self.law.bends_smoothly and not self.uneven

    def sliding(self, u: Number, F_N: Number) -> Number:
        return self.law.sliding(u, F_N)

    def breakaway(self, F_N: Number) -> Number:
        return self.law.breakaway(F_N)

    def first_breakaway(self, F_N: Number) -> Number:
        return self.law.first_breakaway(F_N)

    def load(self, weight: Number, x: Number, beyond: Truth) -> Number:
        return self.law.load(weight, x, beyond)

    def slope(self, weight: Number) -> Number:
        return self.law.slope(weight)

    @property
    def edge(self) -> Number:
        return self.law.edge


class Tilt(AbstractFrictionEffect):
    """Rails tilted by alpha: `m g sin(alpha)` resists for alpha > 0, and F_N = m g cos(alpha).

    alpha [rad]; null: 0. The part must not slide by itself: |tan(alpha)| < mu_k.
    """

    law: AbstractFriction
    alpha: Number = 0.0

    def load(self, weight: Number, x: Number, beyond: Truth) -> Number:
        return self.law.load(weight * xp.cos(self.alpha), x, beyond)

    def slope(self, weight: Number) -> Number:
        return self.law.slope(weight) + weight * xp.sin(self.alpha)


class ExtraLoad(AbstractFrictionEffect):
    """A constant normal force beside the weight's: `F_N = m g + extra`.

    extra [N], either sign, F_N > 0; null: 0.
    """

    law: AbstractFriction
    extra: Number = 0.0

    def load(self, weight: Number, x: Number, beyond: Truth) -> Number:
        return self.law.load(weight, x, beyond) + self.extra


class Drift(AbstractFrictionEffect):
    """mu changes linearly over the order of the pushes: `mu (1 + drift s)`, s from 0 at the
    first push to 1 at the last. mu_s and mu_k alike.

    drift > -1; `share` is the push's s; null: drift = 0.
    """

    law: AbstractFriction
    drift: Number = 0.0
    share: Number = 0.0

    def load(self, weight: Number, x: Number, beyond: Truth) -> Number:
        # mu acts through mu F_N alone.
        return self.law.load(weight, x, beyond) * (1 + self.drift * self.share)


class Waviness(AbstractFrictionEffect):
    """Friction that waves along the rails: `mu (1 + a sin(2 pi x / lambda + phi))`.

    a < 1, lambda > 0 [m], phi [rad]; null: a = 0.
    """

    law: AbstractFriction
    amplitude: Number = 0.0
    wavelength: Number = 1e-3
    phase: Number = 0.0
    affine: ClassVar[bool] = False
    uneven: ClassVar[bool] = True

    def load(self, weight: Number, x: Number, beyond: Truth) -> Number:
        wave, _ = sin_cos(2 * pi * x / self.wavelength + self.phase)
        return self.law.load(weight, x, beyond) * (1 + self.amplitude * wave)


class Patch(AbstractFrictionEffect):
    """Friction that changes at a place: `mu (1 + a)` beyond x_p.

    a > -1, x_p [m]; null: a = 0.
    """

    law: AbstractFriction
    amplitude: Number = 0.0
    start: Number = inf
    affine: ClassVar[bool] = False
    uneven: ClassVar[bool] = True

    def load(self, weight: Number, x: Number, beyond: Truth) -> Number:
        return self.law.load(weight, x, beyond) * (1 + xp.where(beyond, self.amplitude, 0.0))

    @property
    def edge(self) -> Number:
        return self.start


class Stribeck(AbstractFrictionEffect):
    """Friction that falls with speed: `mu(u) = mu_k + (mu_s - mu_k) exp(-(u / v_s)^delta)`
    (Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30, 1994, 1083).

    v_s >= 0 [m/s], delta > 0 (None: 2); null: v_s = 0, where mu(u) = mu_k for every u > 0.
    """

    law: AbstractFriction
    v_s: Number = 0.0
    delta: Number | None = None
    affine: ClassVar[bool] = False

    def sliding(self, u: Number, F_N: Number) -> Number:
        falls = self.v_s > 0
        ratio = u / xp.where(falls, self.v_s, 1.0)
        bent = ratio * ratio  # even in u, for any delta
        if self.delta is not None:
            bent = power(bent, 0.5 * self.delta)
        rise = self.law.breakaway(F_N) - self.law.sliding(xp.zeros_like(u), F_N)
        return self.law.sliding(u, F_N) + xp.where(falls, rise * xp.exp(-bent), 0.0)


class QuadraticDrag(AbstractFrictionEffect):
    """Drag that grows as the square of the speed: `+ c u^2`.

    c >= 0 [N s^2/m^2]; null: 0.
    """

    law: AbstractFriction
    c: Number = 0.0
    affine: ClassVar[bool] = False

    def sliding(self, u: Number, F_N: Number) -> Number:
        return self.law.sliding(u, F_N) + self.c * u * u


class Dwell(AbstractFrictionEffect):
    """Static friction that has grown at rest: `mu_s (1 + a ln(1 + t_rest / tau))` before the
    push (Dieterich, Pure and Applied Geophysics 116, 1978, 790). mu_k, and a halt within the push,
    are as without.

    a >= 0, tau > 0 [s], rest >= 0 [s] the push's own; null: a = 0.
    """

    law: AbstractFriction
    amplitude: Number = 0.0
    tau: Number = 1.0
    rest: Number = 0.0
    affine: ClassVar[bool] = False
    uneven: ClassVar[bool] = True

    def first_breakaway(self, F_N: Number) -> Number:
        grown = 1 + self.amplitude * xp.log1p(self.rest / self.tau)
        return self.law.first_breakaway(F_N) * grown


class Presliding(AbstractFrictionEffect):
    """Bristles that bend before they slip, and replace the stuck mode (LuGre: Canudas de Wit,
    Olsson, Åström and Lischinsky, IEEE Trans. Automatic Control 40, 1995, 419; Dahl: sigma_1 = 0):

        F = sigma_0 q + sigma_1 q' + k_v u,   q' = u - sigma_0 |u| q / g,   g = mu_k F_N.

    sigma_0 > 0 [N/m], sigma_1 >= 0 [N s/m]. No value of sigma_0 gives the plain law exactly: it
    is the limit sigma_0 -> infinity, with mu_s = mu_k. mu_s acts through mu_k alone.
    """

    law: AbstractFriction
    compliance: Number = 1e-7
    """1 / sigma_0 [m/N]"""
    sigma_1: Number = 0.0
    affine: ClassVar[bool] = False
    bends_smoothly: ClassVar[bool] = False

    def bend(self, u: Number, way: Number, q: Number, F_N: Number) -> tuple[Number, Number]:
        """(friction force [N], q' [m/s]) at the deflection q [m], where u has the sign `way`."""
        slip = self.law.sliding(xp.zeros_like(u), F_N)
        held = self.stiffness * q
        dq = u * (1 - way * held / slip)
        rest = way * (self.law.sliding(way * u, F_N) - slip)
        return held + self.sigma_1 * dq + rest, dq

    def find_yield(self, way: Number, F_N: Number) -> Number:
        """The deflection [m] at which bristles slip, where u has the sign `way`."""
        return way * self.law.sliding(xp.zeros_like(way), F_N) * self.compliance

    @property
    def stiffness(self) -> Number:
        """sigma_0 [N/m]."""
        return 1.0 / self.compliance


def innermost(law: Any) -> Any:
    """The law that all effects stand around."""
    while hasattr(law, "law"):
        law = law.law
    return law
