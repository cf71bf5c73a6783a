"""Closed forms of the two affine motions: the damped oscillator and the viscous slide.

Everything here holds without a break from underdamped through critical to overdamped, and
for a vanishing viscosity; forward derivatives pass through each of these limits. What a choice
(`xp.where`) leaves aside may be no number: it costs less than to mask it, and derivatives in
forward mode leave it aside as well. XLA computes again, wherever it is used, what holds no
division, root or exponential: results that are used more than once end in one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from difffric.compute import arrays as xp
from difffric.compute.arrays import polynomial
from difffric.compute.elementary_functions import angle, log1p, quotient, sin_cos
from difffric.compute.lanes import choose
from difffric.rig.number import Number

if TYPE_CHECKING:
    from jaxtyping import Array, Float

# Coefficients of the series that take over where the closed forms divide by nearly nothing: of
# sin(x)/x and cos(x) in x^2, arctan(x)/x in x^2, (1 - (1 - e^-x)/x)/x and (1 - log(1 + y)/y)/y.
_SINE = [(-1.0) ** n / float(np.prod(np.arange(1.0, 2 * n + 2))) for n in range(8)]
_COSINE = [(-1.0) ** n / float(np.prod(np.arange(1.0, 2 * n + 1))) for n in range(8)]
_ARCTAN = [(-1.0) ** n / (2 * n + 1) for n in range(10)]
_DECAY = [(-1.0) ** n / float(np.prod(np.arange(1.0, n + 3))) for n in range(14)]
_BRAKE = [(-1.0) ** n / (n + 2) for n in range(14)]


class Oscillator(NamedTuple):
    """p'' + 2 alpha p' + omega0_sq p = 0."""

    alpha: Number
    """damping [1/s]"""
    omega0_sq: Number
    """[1/s^2]"""

    @property
    def discriminant(self) -> Number:
        """omega0^2 - alpha^2: positive underdamped, negative overdamped [1/s^2]."""
        return self.omega0_sq - self.alpha**2

    def rate(self) -> Float[Array, ""]:
        """omega, or what takes its place overdamped [1/s]; 1 where critical."""
        D = self.discriminant
        return xp.sqrt(xp.where(D == 0, 1.0, xp.abs(D)))

    def basis(self, t: Number) -> tuple[Array, Array]:
        """exp(-alpha t) times cos(omega t) and sin(omega t)/omega, omega^2 = discriminant."""
        D, rate = self.discriminant, self.rate()
        x = D * t**2
        small = xp.abs(x) < 0.1
        over = (D <= 0) & ~small
        sine, cosine = sin_cos(rate * t)
        fades = xp.exp(-2 * rate * t)  # the faster exponential beside the slower one
        slower = xp.where(over, quotient(self.omega0_sq, self.alpha + rate), self.alpha)
        growth = xp.exp(xp.minimum(slower * t, 700.0))
        c = choose(small, lambda: polynomial(_COSINE, x), lambda: cosine)
        s = choose(small, lambda: t * polynomial(_SINE, x), lambda: sine)
        return (
            quotient(xp.where(over, 0.5 + 0.5 * fades, c), growth),
            quotient(xp.where(over, 0.5 - 0.5 * fades, s), growth * xp.where(small, 1.0, rate)),
        )

    def flow(self, p: Number, dp: Number, t: Number) -> tuple[Array, Array]:
        """(p, p') after the time t [s]."""
        c, s = self.basis(t)
        q = self.alpha * dp + self.omega0_sq * p
        return p * c + (dp + self.alpha * p) * s, dp * c - q * s

    def turning_time(self, p: Number, dp: Number, sign: float) -> Float[Array, ""]:
        """First t >= 0 with p' = 0, where sign * p' >= 0 at the start; infinite if never.

        With p' = 0 at the start and p on the far side (sign * p < 0) it is half a period.
        """
        D = self.discriminant
        W = sign * dp
        Q = sign * (self.alpha * dp + self.omega0_sq * p)
        ratio = quotient(W, xp.where(Q > 0, Q, 1.0))
        s = D * ratio**2
        small = (Q > 0) & (xp.abs(s) < 0.01)
        rate = self.rate()
        phase = angle(rate * W, Q)
        # W may be a rounding below zero: half a period ahead all the same.
        phase = xp.where(phase < 0, phase + 2 * xp.pi, phase)
        r = rate * ratio
        hyperbolic = 0.5 * log1p(quotient(2 * r, 1 - r))
        ends = (D < 0) & (Q > rate * W)
        free = xp.where(D > 0, phase, xp.where(ends, hyperbolic, xp.inf))
        angle_ = choose(small, lambda: ratio * polynomial(_ARCTAN, s), lambda: free)
        return quotient(angle_, xp.where(small, 1.0, rate))

    def extremum(self, p: Number, dp: Number, t: Float[Array, ""]) -> Float[Array, ""]:
        """|p| at a turning time t: omega0^2 p^2 + 2 alpha p p' + p'^2 falls as exp(-2 alpha t),
        so that no trigonometry is needed."""
        Q = self.omega0_sq * p**2 + 2 * self.alpha * p * dp + dp**2
        Q = xp.where(Q > 0, Q, 0.0)
        root = xp.where(Q > 0, xp.sqrt(xp.where(Q > 0, Q, 1.0)), 0.0)
        return quotient(xp.exp(-self.alpha * t) * root, xp.sqrt(self.omega0_sq))


class ViscousSlide(NamedTuple):
    """u' = -(drag + rate u): Coulomb and viscous friction per unit of mass."""

    drag: Number
    """[m/s^2]"""
    rate: Number
    """[1/s]"""

    def flow(self, u: Number, t: Number) -> tuple[Array, Array]:
        """(distance [m], speed [m/s]) after the time t [s], from the speed u [m/s]."""
        x = self.rate * t
        small = xp.abs(x) < 0.2
        x_l = xp.where(small, 1.0, x)
        series = choose(small, lambda: polynomial(_DECAY, x), lambda: x)
        one = choose(small, lambda: 1.0 - x * series, lambda: -xp.expm1(-x_l) / x_l)
        two = choose(small, lambda: series, lambda: (x_l + xp.expm1(-x_l)) / x_l**2)
        return t * (u * one - self.drag * t * two), u - (self.drag + self.rate * u) * t * one

    def rest(self, u: Number) -> tuple[Array, Array]:
        """(time [s], distance [m]) to rest from the speed u [m/s]."""
        stop = quotient(u, self.drag)
        y = self.rate * stop
        small = xp.abs(y) < 0.1
        inverse = quotient(1.0, xp.where(small, 1.0, y))
        mean = choose(small, lambda: y, lambda: log1p(y) * inverse)
        half = choose(small, lambda: polynomial(_BRAKE, y), lambda: (1.0 - mean) * inverse)
        one = choose(small, lambda: 1.0 - y * half, lambda: mean)
        return stop * one, u * stop * half
