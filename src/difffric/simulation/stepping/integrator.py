"""The integrator that a user names: `RungeKutta`, for laws of any kind."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from difffric.rig.rig import Rig
from difffric.simulation.dynamics import Motion
from difffric.simulation.stepping.loop import MAX_STEPS, Marcher


class RungeKutta(eqx.Module):
    """Runge-Kutta steps with exact events for laws of any kind: fast, and differentiable twice in
    forward mode. `tol` is the error allowed to a step, relative to the scales of the push.

    `looped` compiles sooner and runs slower: for rigs with many effects. A push that takes more
    than `most` steps is not followed to its end.
    """

    tol: float = eqx.field(default=1e-10, static=True)
    looped: bool | None = eqx.field(default=None, static=True)
    most: int = eqx.field(default=MAX_STEPS, static=True)

    def check(self, rig: Rig):
        """Every rig is served."""

    def marcher(self, rig: Rig, v, blind: bool = False) -> Marcher:
        """The push of a rig at the speed v [m/s] that its pusher comes to; `blind`: its motion
        alone."""
        looped = self.looped if self.looped is not None else _depth(rig) > 3
        weight = stop_gradient(rig.F_N)
        z_0 = stop_gradient(_reach(rig.contact, weight))
        return Marcher(Motion(rig, v), z_0, self.tol, looped, blind, self.most)


def _reach(contact, force):
    """A compression [m] that carries a force [N]: at most four times the least that does."""

    def short(z):
        return (contact.approach(z, jnp.zeros_like(z)) < force) & (z < 1e3)

    return jax.lax.while_loop(short, lambda z: 4 * z, jnp.asarray(1e-9))


def _depth(rig: Rig) -> int:
    """How many effects stand around the rig's laws."""
    count = 0
    for part in (rig.friction, rig.contact, rig.pusher, rig.force_sensor, rig.probe):
        while hasattr(part, "law"):
            part, count = part.law, count + 1
    return count
