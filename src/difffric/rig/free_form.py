"""Laws around a law that correct it by a smooth curve of no particular form.

Where no effect of the catalogue explains a misfit, such a curve in one component after the other
shows where it sits, and what is missing there: `law (1 + g)`, g a sum of cubic B-splines over the
quantity that the law depends on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from difffric.compute import arrays as xp
from difffric.compute.number_tree import NumberTree, put_parts
from difffric.rig.catalogue import CONTACT, FORCE, FRICTION, PROBE, PUSHER
from difffric.rig.contact import AbstractContact, AbstractContactEffect
from difffric.rig.friction import AbstractFriction, AbstractFrictionEffect
from difffric.rig.number import Number, Truth
from difffric.rig.pusher import AbstractPusher, AbstractPusherEffect
from difffric.rig.rig import Rig
from difffric.rig.scales import Scales
from difffric.rig.sensors import (
    AbstractForceEffect,
    AbstractForceSensor,
    AbstractProbe,
    AbstractProbeEffect,
)

SPLINES = 8
"""How many make up a curve."""


class Curve(NumberTree):
    """g(x) = sum_k c_k B(s (n - 1) - k), s = log(1 + x / bend) / log(1 + end / bend) within 0..1:
    fine below `bend`, coarser towards `end`, and constant beyond."""

    c: Any
    """(n,)"""
    end: Any
    bend: Any

    def __call__(self, x: Number) -> Number:
        s = xp.log1p(xp.maximum(x, 0.0) / self.bend) / xp.log1p(self.end / self.bend)
        at = xp.minimum(s, 1.0) * (SPLINES - 1)
        if not xp.uses_jax(at, self.c):
            return sum(self.c[..., i] * _evaluate_spline(at - i) for i in range(SPLINES))
        # Of all splines the four that are not zero there: with each by itself programs were four
        # times as large, with all in one array twice as slow.
        first = xp.minimum(xp.floor(at), SPLINES - 2.0)
        t, u = at - first, 1 - at + first
        one, two, three, four = self._pick_four(first)
        ends = one * u**3 + four * t**3
        inner = two * ((3 * t - 6) * t**2 + 4) + three * ((3 * u - 6) * u**2 + 4)
        return (ends + inner) / 6

    def _pick_four(self, first: Any) -> Any:
        """The coefficients of the splines that are not zero between `first` and the next."""
        import jax.numpy as jnp

        padded = jnp.pad(self.c, [(0, 0)] * (self.c.ndim - 1) + [(1, 1)])
        return [padded[..., (first + k).astype(int)] for k in range(4)]


def _evaluate_spline(x: Number) -> Number:
    """The cubic B-spline on whole numbers that is centred at 0."""
    away = xp.abs(x)
    return (xp.maximum(2 - away, 0.0) ** 3 - 4 * xp.maximum(1 - away, 0.0) ** 3) / 6


class FreeSpeed(AbstractFrictionEffect):
    """Sliding friction corrected over the speed: `mu_k (1 + g(u))`."""

    law: AbstractFriction
    g: Any = None
    affine: ClassVar[bool] = False

    def sliding(self, u: Number, F_N: Number) -> Number:
        return self.law.sliding(u, F_N) + self.g(u) * self.law.sliding(xp.zeros_like(u), F_N)


class FreePlace(AbstractFrictionEffect):
    """Friction corrected over the position: `mu (1 + g(x))`."""

    law: AbstractFriction
    g: Any = None
    affine: ClassVar[bool] = False
    uneven: ClassVar[bool] = True

    def load(self, weight: Number, x: Number, beyond: Truth) -> Number:
        return self.law.load(weight, x, beyond) * (1 + self.g(x))


class FreeSpring(AbstractContactEffect):
    """The spring corrected over the compression: `k z (1 + g(z))`."""

    law: AbstractContact
    g: Any = None

    def approach(self, z: Number, w: Number) -> Number:
        return self.law.approach(z * (1 + self.g(z)), w)

    def rebound(self, z: Number, w: Number) -> Number:
        return self.law.rebound(z * (1 + self.g(z)), w)


class FreeLoss(AbstractContactEffect):
    """A loss of the spring's own, as in a contact that lags: `k z (1 + g(z) w / w_r)`, at approach
    and on rebound; a constant g is the loss of Hunt and Crossley (J. Appl. Mech. 42 (1975) 440).

    w_r = 0.1 m/s: there the spring's force is another by the share g.
    """

    law: AbstractContact
    g: Any = None
    w_r: ClassVar[float] = 0.1

    def _press(self, z: Number, w: Number) -> Number:
        return z * (1 + self.g(z) * w / self.w_r)

    def approach(self, z: Number, w: Number) -> Number:
        return self.law.approach(self._press(z, w), w)

    def rebound(self, z: Number, w: Number) -> Number:
        return self.law.rebound(self._press(z, w), w)


class FreeTravel(AbstractPusherEffect):
    """The tip's speed corrected over its travel: `v (1 + g(y))`."""

    law: AbstractPusher
    g: Any = None
    constant: ClassVar[bool] = False

    def ripple(self, y: Number) -> Number:
        return self.law.ripple(y) * (1 + self.g(y))


class FreeForce(AbstractForceEffect):
    """The reading corrected over the force: `f (1 + g(|f|))`."""

    law: AbstractForceSensor
    g: Any = None

    def read(self, f: Number) -> Number:
        return self.law.read(f * (1 + self.g(xp.abs(f))))


class FreeProbe(AbstractProbeEffect):
    """The probe's reading corrected over the position: `x (1 + g(x))`."""

    law: AbstractProbe
    g: Any = None

    def read(self, x: Number) -> Number:
        return self.law.read(x * (1 + self.g(x)))


@dataclass(frozen=True)
class Form:
    """A component's free form."""

    component: str
    law: Callable[..., Any]
    quantity: str
    """what the curve is over, as a person reads it"""
    unit: str
    over: Callable[[Scales], tuple[float, float]]
    """the curve's end and bend"""
    beside: tuple[str, ...] = ()
    """numbers of effects that the component may need with it: what has a memory has no curve"""
    least: float = 0.0
    """share of a misfit that the curve has to explain where another one can be told"""


FORMS = {
    "friction_speed": Form(
        FRICTION, FreeSpeed, "speed of the part", "m/s", lambda s: (2 * s.fastest, s.slowest)
    ),
    "friction_place": Form(
        FRICTION, FreePlace, "position of the part", "m",
        lambda s: (float(s.ways.max()), 0.5 * float(s.ways.min())),
    ),
    "spring": Form(
        CONTACT, FreeSpring, "compression", "m", lambda s: (s.compression, 10 * s.compression),
        ("rebound_damping.b_N_s_per_m",),
    ),
    "loss": Form(
        CONTACT, FreeLoss, "compression, at 0.1 m/s", "m",
        lambda s: (s.compression, 10 * s.compression), ("rebound_damping.b_N_s_per_m",),
        0.6,  # of whatever changes fast it follows a little: 0.37 of a tip that rings
    ),
    "travel": Form(
        PUSHER, FreeTravel, "travel of the tip", "m", lambda s: (s.travel, 0.3 * s.travel),
        ("pusher_lag.tau_s", "pusher_ramp.acceleration_m_per_s2"),
    ),
    "force": Form(
        FORCE, FreeForce, "force", "N", lambda s: (s.peak, 10 * s.peak),
        ("force_lowpass.tau_s", "force_highpass.tau_s", "force_offset.offset_N"),
    ),
    "probe": Form(
        PROBE, FreeProbe, "position of the part", "m",
        lambda s: (float(s.ways.max()), 0.5 * float(s.ways.min())), ("channel_skew.delay_s",),
    ),
}  # fmt: skip


def names(form: str) -> tuple[str, ...]:
    """Of a form's coefficients."""
    return tuple(f"{form}:{k}" for k in range(SPLINES))


def free_rig(rig: Rig, scales: Scales) -> Rig:
    """The rig with all forms, at zero."""
    for form in FORMS.values():
        end, bend = form.over(scales)
        curve = Curve(np.zeros(SPLINES), end, bend)
        law = form.law(getattr(rig, form.component), g=curve)
        rig = replace(rig, **{form.component: law})
    return rig


def curve_of(rig: Rig, form: str) -> Any:
    """The curve of one form within a rig that has all."""
    at = getattr(rig, FORMS[form].component)
    while not isinstance(at, FORMS[form].law):  # pyright: ignore[reportArgumentType]
        at = at.law
    return at.g


def with_coefficients(rig: Rig, new: dict[str, Any]) -> Rig:
    """The rig with the coefficients (SPLINES,) of some forms replaced."""
    return put_parts(rig, lambda r: [curve_of(r, form).c for form in new], list(new.values()))


def basis(form: str, scales: Scales, x: np.ndarray) -> np.ndarray:
    """(len(x), SPLINES): the curve at x is this times its coefficients."""
    curves = [Curve(row, *FORMS[form].over(scales)) for row in np.eye(SPLINES)]
    at: Any = np.asarray(x)
    rows = [np.asarray(g(at)) for g in curves]
    return np.stack(rows, axis=1)
