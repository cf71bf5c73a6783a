"""The rig: part, friction, contact, pusher and sensors, and equation (2) in each mode of a push."""

from __future__ import annotations

from typing import Any

from difffric.compute.number_tree import NumberTree
from difffric.rig import force_balance
from difffric.rig.contact import UnilateralSpringDamper
from difffric.rig.friction import ViscousCoulomb
from difffric.rig.number import Number, Truth
from difffric.rig.pusher import ConstantSpeed
from difffric.rig.sensors import ForceSensor, Probe
from difffric.units import GRAVITY


class Rig(NumberTree):
    """A part on rails in front of a push tip. All fields in SI units.

    Every number in it may be a Python float or a JAX value, so a rig can be differentiated
    and batched like any array.
    """

    mass: Number
    friction: Any
    contact: Any
    pusher: Any = ConstantSpeed()
    force_sensor: Any = ForceSensor()
    probe: Any = Probe()

    @property
    def F_N(self) -> Number:
        """Normal force [N] where the push starts: m g on level rails."""
        return self.load(0.0, False)

    def load(self, x: Number, beyond: Truth) -> Number:
        """Normal force [N] at the position x [m]; `beyond`: past the friction's `edge`."""
        return self.friction.load(self.mass * GRAVITY, x, beyond)

    @property
    def slope(self) -> Number:
        """What gravity itself holds against the push [N]: 0 on level rails."""
        return self.friction.slope(self.mass * GRAVITY)

    @property
    def affine(self) -> bool:
        """Whether every segment of a push has a closed form, and what is read of it too."""
        return self.friction.affine and self._is_affine_but_for_friction

    @property
    def bends_smoothly(self) -> bool:
        """Whether every law is affine but friction, which the speed alone may bend."""
        return self.friction.bends_smoothly and self._is_affine_but_for_friction

    @property
    def _is_affine_but_for_friction(self) -> bool:
        sensor = self.force_sensor
        looks_back = sensor.filtered or sensor.sampled or self.probe.looked_up
        return self.contact.affine and self.pusher.constant and not looks_back

    @property
    def sensor_errors(self) -> tuple[float | None, float | None]:
        """Standard errors of F_p [N] and d [m] that the sensors alone explain.

        d is the difference of two readings, each with its noise and its quantum. None where a
        sensor's noise is not known.
        """
        F, probe = self.force_sensor.noise, self.probe
        if probe.noise is None:
            return F, None
        return F, float((2 * (probe.noise**2 + probe.resolution**2 / 12)) ** 0.5)

    @property
    def all_laws(self) -> list[Any]:
        """Every law of it, those within others too."""
        laws: list[Any] = [self.friction, self.contact, self.pusher, self.force_sensor, self.probe]
        for law in laws:
            if hasattr(law, "law"):
                laws.append(law.law)
        return laws

    @property
    def only_own_laws(self) -> bool:
        """Whether all its laws are of this library, and none a user's."""
        return all(type(law).__module__.startswith("difffric.") for law in self.all_laws)

    def approaching(self, z: Number, w: Number, u: Number) -> Number:
        """Equation (2) while the tip closes in on the part: x'' [m/s^2].

        z [m] is the compression, w [m/s] its rate, u [m/s] the speed of the part.
        """
        return self._accelerate(self.contact.approach(z, w), u)

    def rebounding(self, z: Number, w: Number, u: Number) -> Number:
        """Equation (2) while the part recedes from the tip: x'' [m/s^2]."""
        return self._accelerate(self.contact.rebound(z, w), u)

    def free(self, u: Number) -> Number:
        """Equation (2) without contact: x'' [m/s^2]."""
        return self._accelerate(0.0, u)

    def _accelerate(self, F_contact: Number, u: Number) -> Number:
        """The acceleration [m/s^2] of the part that slides at u under the contact's force [N]."""
        F_friction = self.friction.sliding(u, self.F_N)
        return force_balance.accelerate(F_contact, F_friction, self.slope, self.mass)


def spring_damper_rig(
    *,
    mass: Number,
    mu_s: Number,
    k: Number,
    b: Number,
    mu_k_over_mu_s: Number = 0.75,
    k_v: Number = 0.0,
    stroke: Number | None = None,
    **sensors: Any,
) -> Rig:
    """The paper's rig: equation (1) on the rails, equation (2) at the tip.

    mass [kg], k [N/m], b and k_v [N s/m], stroke [m]; `sensors` may have a `force_sensor` and a
    `probe`.
    """
    return Rig(
        mass=mass,
        friction=ViscousCoulomb(mu_s, mu_k_over_mu_s, k_v),
        contact=UnilateralSpringDamper(k, b),
        pusher=ConstantSpeed(stroke),
        **sensors,
    )
