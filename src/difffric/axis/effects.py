"""What an axis may do beyond Coulomb and viscous friction: one class an effect, and one table.

Each class says by how much the resistance [N] at a point of the motion is larger than in the plain
equation, and its derivatives. At its null value an effect changes nothing. A negative resistance
pulls the axis along. The laws are analytic for either direction, so that a simulation can carry
derivatives through them as imaginary parts.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_COULOMB, _VISCOUS, _BREAKAWAY = "coulomb_N", "k_v_N_s_per_m", "breakaway_N"


@dataclass(frozen=True)
class Point:
    """Where an axis is: at many samples (n,) of one run, or at one moment."""

    position: NDArray
    """[m]"""
    speed: NDArray
    """[m/s], of the same sign as `sign`, or 0"""
    sign: int
    """direction of motion, 1 or -1; |u| is sign * speed, which differentiates as it stands"""
    order: float = 0.0
    """place of the stretch among all, from -1/2 to 1/2"""


@dataclass(frozen=True)
class AxisKey:
    """A number of an effect, as set-ups write it."""

    name: str
    null: float
    typical: float
    """where a search begins"""
    is_scanned: bool = False
    """whether a search tries a grid of it: the misfit has several minima in it"""
    is_fixed: bool = False
    """whether it stays at its typical value unless asked for"""


class AbstractResistance(abc.ABC):
    """The law of an effect: forces in newtons, positive where they resist motion forwards."""

    @abc.abstractmethod
    def resist(self, point: Point, plain: Mapping[str, Any], *sizes: Any) -> NDArray:
        """Return the force that is added to the friction, with its sign."""

    @abc.abstractmethod
    def differentiate(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> Sequence[NDArray]:
        """Return its derivatives by each of the effect's numbers."""

    def differentiate_plain(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> dict[str, NDArray]:
        """Return its derivatives by plain parameters, where it depends on some."""
        return {}


class Direction(AbstractResistance):
    """Coulomb friction (1 + a) and viscous friction (1 + c) times as large forwards, (1 - a) and
    (1 - c) times backwards: adds F_c a + k_v c |u|. Null: a = c = 0. A constant force is also what
    an offset does: a and the offset are never told apart by motion alone."""

    def resist(self, point: Point, plain: Mapping[str, Any], *sizes: Any) -> NDArray:
        a, c = sizes
        return plain[_COULOMB] * a + plain[_VISCOUS] * c * point.sign * point.speed

    def differentiate(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> Sequence[NDArray]:
        speed = point.sign * point.speed
        return plain[_COULOMB] + 0 * speed, plain[_VISCOUS] * speed

    def differentiate_plain(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> dict[str, NDArray]:
        a, c = sizes
        speed = point.sign * point.speed
        return {_COULOMB: a + 0 * speed, _VISCOUS: c * speed}


class AxisStribeck(AbstractResistance):
    """Coulomb friction rises from F_c to the break-away force as the speed falls: adds
    (F_s - F_c) exp(-(u / v_s)^2) sign(u) (Stribeck 1902; Armstrong-Helouvry et al. 1994).
    Null: v_s = 0."""

    def resist(self, point: Point, plain: Mapping[str, Any], *sizes: Any) -> NDArray:
        (v_s,) = sizes
        rise = _get_breakaway(plain) - plain[_COULOMB]
        return point.sign * rise * self._fall(point, v_s)

    def differentiate(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> Sequence[NDArray]:
        (v_s,) = sizes
        by_speed = 2 * point.speed**2 / v_s**3
        return (self.resist(point, plain, v_s) * by_speed,)

    def differentiate_plain(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> dict[str, NDArray]:
        fall = point.sign * self._fall(point, sizes[0])
        return {_COULOMB: -fall, _BREAKAWAY: fall}

    def _fall(self, point: Point, v_s: float) -> NDArray:
        return np.exp(-((point.speed / v_s) ** 2))


class Strengthening(AbstractResistance):
    """Coulomb friction that rises with the logarithm of speed: adds F_c a ln(1 + |u| / u_0)
    sign(u) (velocity strengthening: Dieterich 1979, Ruina 1983). Null: a = 0."""

    def resist(self, point: Point, plain: Mapping[str, Any], *sizes: Any) -> NDArray:
        a, u_0 = sizes
        return point.sign * plain[_COULOMB] * a * np.log1p(point.sign * point.speed / u_0)

    def differentiate(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> Sequence[NDArray]:
        a, u_0 = sizes
        speed = point.sign * point.speed
        size = point.sign * plain[_COULOMB]
        return size * np.log1p(speed / u_0), -size * a * speed / (u_0 * (u_0 + speed))

    def differentiate_plain(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> dict[str, NDArray]:
        a, u_0 = sizes
        return {_COULOMB: point.sign * a * np.log1p(point.sign * point.speed / u_0)}


class Cogging(AbstractResistance):
    """A force A sin(2 pi x / p + phi) of the drive, the same both ways (slots and magnets of a
    linear motor, or one turn of a screw). Null: A = 0."""

    def resist(self, point: Point, plain: Mapping[str, Any], *sizes: Any) -> NDArray:
        amplitude, period, phase = sizes
        return -amplitude * np.sin(2 * np.pi * point.position / period + phase)

    def differentiate(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> Sequence[NDArray]:
        amplitude, period, phase = sizes
        angle = 2 * np.pi * point.position / period + phase
        by_angle = -amplitude * np.cos(angle)
        return -np.sin(angle), by_angle * -2 * np.pi * point.position / period**2, by_angle


class AxisWaviness(AbstractResistance):
    """Coulomb friction that varies along the axis: adds F_c a sin(2 pi x / lambda + phi) sign(u).
    Null: a = 0."""

    def resist(self, point: Point, plain: Mapping[str, Any], *sizes: Any) -> NDArray:
        a, wavelength, phase = sizes
        angle = 2 * np.pi * point.position / wavelength + phase
        return point.sign * plain[_COULOMB] * a * np.sin(angle)

    def differentiate(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> Sequence[NDArray]:
        a, wavelength, phase = sizes
        size = point.sign * plain[_COULOMB]
        angle = 2 * np.pi * point.position / wavelength + phase
        by_angle = size * a * np.cos(angle)
        turns = -2 * np.pi * point.position / wavelength**2
        return size * np.sin(angle), by_angle * turns, by_angle

    def differentiate_plain(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> dict[str, NDArray]:
        a, wavelength, phase = sizes
        angle = 2 * np.pi * point.position / wavelength + phase
        return {_COULOMB: point.sign * a * np.sin(angle)}


class AxisDrag(AbstractResistance):
    """A drag c u |u|, of air or of a churned lubricant. Null: c = 0."""

    def resist(self, point: Point, plain: Mapping[str, Any], *sizes: Any) -> NDArray:
        return sizes[0] * point.sign * point.speed**2

    def differentiate(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> Sequence[NDArray]:
        return (point.sign * point.speed**2,)


class AxisDrift(AbstractResistance):
    """Coulomb friction that changes linearly over the order of the stretches, by the share `drift`
    from first to last: adds F_c drift (order) sign(u). Null: 0."""

    def resist(self, point: Point, plain: Mapping[str, Any], *sizes: Any) -> NDArray:
        return point.sign * plain[_COULOMB] * sizes[0] * point.order + 0 * point.speed

    def differentiate(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> Sequence[NDArray]:
        return (point.sign * plain[_COULOMB] * point.order + 0 * point.speed,)

    def differentiate_plain(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> dict[str, NDArray]:
        return {_COULOMB: point.sign * sizes[0] * point.order + 0 * point.speed}


class Late(AbstractResistance):
    """The motion answers the recorded force later, by `delay_s`: force(t - delay), which is no
    force of its own. Null: 0."""

    def resist(self, point: Point, plain: Mapping[str, Any], *sizes: Any) -> NDArray:
        return 0 * point.speed

    def differentiate(
        self, point: Point, plain: Mapping[str, Any], *sizes: Any
    ) -> Sequence[NDArray]:
        return (0 * point.speed,)


def _get_breakaway(plain: Mapping[str, Any]) -> float:
    return plain.get(_BREAKAWAY, plain[_COULOMB])


@dataclass(frozen=True)
class AxisEffect:
    """A line of the table."""

    id: str
    component: str
    law: AbstractResistance
    keys: tuple[AxisKey, ...]
    text: str
    """what a person reads"""
    delays: bool = False
    """whether it shifts the force in time instead of adding one"""


_PHASE = AxisKey("phase_rad", 0.0, 0.0)
EFFECTS = {
    effect.id: effect
    for effect in (
        AxisEffect(
            "friction_direction",
            "friction",
            Direction(),
            (AxisKey("coulomb_share", 0.0, 0.0, is_fixed=True), AxisKey("viscous_share", 0.0, 0.0)),
            "friction depends on the direction of motion",
        ),
        AxisEffect(
            "stribeck",
            "friction",
            AxisStribeck(),
            (AxisKey("v_s_m_per_s", 0.0, 0.01, is_scanned=True),),
            "friction is higher at low speed",
        ),
        AxisEffect(
            "friction_strengthening",
            "friction",
            Strengthening(),
            (AxisKey("amplitude", 0.0, 0.0), AxisKey("speed_m_per_s", 1e-3, 1e-3, True)),
            "friction rises with the logarithm of speed",
        ),
        AxisEffect(
            "cogging",
            "pusher",
            Cogging(),
            (AxisKey("amplitude_N", 0.0, 0.0), AxisKey("period_m", 0.01, 0.01, True), _PHASE),
            "a force of the drive that repeats along the axis",
        ),
        AxisEffect(
            "friction_waviness",
            "friction",
            AxisWaviness(),
            (AxisKey("amplitude", 0.0, 0.0), AxisKey("wavelength_m", 0.01, 0.01, True), _PHASE),
            "friction varies along the axis",
        ),
        AxisEffect(
            "quadratic_drag",
            "friction",
            AxisDrag(),
            (AxisKey("c_N_s2_per_m2", 0.0, 0.0),),
            "a drag that grows with the square of speed",
        ),
        AxisEffect(
            "friction_drift",
            "friction",
            AxisDrift(),
            (AxisKey("drift", 0.0, 0.0),),
            "friction changes over the order of the stretches",
        ),
        AxisEffect(
            "drive_delay",
            "pusher",
            Late(),
            (AxisKey("delay_s", 0.0, 0.0),),
            "the motion answers the recorded force later",
            delays=True,
        ),
    )
}
"""All effects of an axis, by the name that set-ups and results have for them."""


def list_effect_keys(effect: str) -> list[str]:
    """Return the names of an effect's numbers among the parameters: `cogging.amplitude_N`."""
    return [f"{effect}.{key.name}" for key in EFFECTS[effect].keys]
