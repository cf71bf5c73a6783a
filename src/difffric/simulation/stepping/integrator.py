"""The integrator that a user names: `RungeKutta`, for laws of any kind."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from difffric.rig.rig import Rig
from difffric.simulation.dynamics import Motion, find_compression
from difffric.simulation.stepping.loop import MAX_STEPS, StepLoop

_DEEP = 3
"""Effects around a rig's laws beyond which the stages of a step are looped over: that compiles
sooner and runs a fifth slower (decision 7)."""


class RungeKutta(eqx.Module):
    """Runge-Kutta steps with exact events for laws of any kind: fast, and differentiable twice in
    forward mode. `tol` is the error allowed to a step, relative to the scales of the push.

    `looped` compiles sooner and runs slower: for rigs with many effects. A push that takes more
    than `most` steps is not followed to its end.
    """

    tol: float = eqx.field(default=1e-10, static=True)
    looped: bool | None = eqx.field(default=None, static=True)
    most: int = eqx.field(default=MAX_STEPS, static=True)

    def check(self, rig: Rig) -> None:
        """Every rig is served."""

    def build_loop(self, rig: Rig, v: Float[Array, ""], blind: bool = False) -> StepLoop:
        """The push of a rig at the speed v [m/s] that its pusher comes to; `blind`: its motion
        alone."""
        looped = self.looped if self.looped is not None else _count_effects(rig) > _DEEP
        weight = stop_gradient(rig.F_N)

        def carry(z):
            return rig.contact.approach(z, jnp.zeros_like(z))

        z_0 = stop_gradient(find_compression(carry, weight))
        return StepLoop(Motion(rig, v), z_0, self.tol, looped, blind, self.most)


def _count_effects(rig: Rig) -> int:
    """How many effects stand around the rig's laws."""
    count = 0
    for part in (rig.friction, rig.contact, rig.pusher, rig.force_sensor, rig.probe):
        while hasattr(part, "law"):
            part, count = part.law, count + 1
    return count
