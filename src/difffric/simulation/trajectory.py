"""A trajectory: the segments of a push, to be evaluated exactly at any time."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from difffric.compute import pytrees
from difffric.compute.program_cache import cache_program
from difffric.errors import InputError
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.rig.setup import check_rig
from difffric.simulation.events import MAX_CYCLES, Regime, explain
from difffric.simulation.observables import Observables, observe_segments, observe_steps
from difffric.simulation.segment_motion import move_within
from difffric.simulation.segments import Integrator, Push, Segment
from difffric.simulation.stepping.integrator import RungeKutta
from difffric.simulation.stepping.path import PushPath, follow

STRIDES = 1024
"""Steps that a trajectory keeps at most where a push is followed step by step; one of more counts
as not followed."""


class Trajectory(eqx.Module):
    """One push from t = 0 to rest: `.force(t)`, `.position(t)`, `.speed(t)` and the
    observables. A pytree: it can be differentiated and batched.
    """

    push: Push
    segments: Segment
    observables: Observables
    path: PushPath | None = None
    """the strides of a push that was integrated step by step; each is a segment"""

    @classmethod
    def of(cls, push: Push, cycles: int = MAX_CYCLES, strides: int = STRIDES) -> Trajectory:
        """Follow a push, for so many cycles through the modes (or strides) at most."""
        if isinstance(push.integrator, RungeKutta):
            loop = push.integrator.build_loop(push.rig, push.velocity)
            end, path = follow(loop, strides)
            return cls(push, _segments(path), observe_steps(loop, end), path)
        state, segments = push.segments(cycles)
        return cls(push, segments, observe_segments(push, state))

    @property
    def peak_force(self):
        """F_p [N]."""
        return self.observables.peak_force

    @property
    def sliding_distance(self):
        """d [m]; NaN where it does not exist: `reason` says why."""
        return self.observables.sliding_distance

    @property
    def reason(self) -> str | None:
        """Why d (or more) does not exist; None where it does."""
        return explain(int(self.observables.reason))

    @property
    def regime(self) -> str:
        """How the push went."""
        return Regime(int(self.observables.regime)).word

    @property
    def stop_time(self):
        """When the part comes to rest for good [s] (its last segment's start)."""
        if self.path is not None:
            return self.path.end.s.t
        t = self.segments.t
        return jnp.max(jnp.where(jnp.isfinite(t), t, 0.0))

    def force(self, t: Float[ArrayLike, " n"]) -> Float[Array, " n"]:
        """Contact force [N] at the times t [s]; zero before the push."""
        return self.evaluate(t)[0]

    def position(self, t: Float[ArrayLike, " n"]) -> Float[Array, " n"]:
        """Position x of the part [m] at the times t [s], zero at its start."""
        return self.evaluate(t)[1]

    def speed(self, t: Float[ArrayLike, " n"]) -> Float[Array, " n"]:
        """Speed u = x' of the part [m/s] at the times t [s]."""
        return self.evaluate(t)[2]

    def evaluate(
        self, t: Float[ArrayLike, "*n"]
    ) -> tuple[Float[Array, "*n"], Float[Array, "*n"], Float[Array, "*n"]]:
        """(force [N], position [m], speed [m/s]) at the times t [s], in one call.

        NaN beyond the last segment followed where the push never ends.
        """
        return _evaluate(self, jnp.asarray(t, float))

    def read(
        self, t_force: Float[ArrayLike, " force"], t_position: Float[ArrayLike, " position"]
    ) -> tuple[Float[Array, " force"], Float[Array, " position"]]:
        """What the sensors read: force [N] and position [m], each at its own times [s]."""
        return _read(self, jnp.asarray(t_force, float), jnp.asarray(t_position, float))


@cache_program
def _evaluate(trajectory: Trajectory, t):
    def at(time):
        if trajectory.path is not None:
            return trajectory.path.evaluate(time)
        return _at(trajectory, time)

    return jnp.vectorize(at, signature="()->(),(),()")(t)


@cache_program
def _read(trajectory: Trajectory, t_force, t_position):
    if trajectory.path is not None:
        return trajectory.path.read(t_force, t_position)
    sensor, probe = trajectory.push.rig.force_sensor, trajectory.push.rig.probe
    force = _evaluate(trajectory, t_force)[0]
    return sensor.read(force), probe.read(_evaluate(trajectory, t_position - probe.delay)[1])


def _segments(path: PushPath) -> Segment:
    """The strides as segments."""

    def start(stride):
        return stride.point(path.motion, 0.0), path.motion.tip(
            stride.course, stride.point(path.motion, 0.0)
        )[1]

    s, v_p = jax.vmap(start)(path.strides._replace(h=jnp.maximum(path.strides.h, 1e-30)))
    return Segment(path.strides.course.mode, path.strides.t, s.y, v_p, s.z, s.u)


def _at(trajectory: Trajectory, time):
    rig, _, integrator = trajectory.push
    table = trajectory.segments
    index = jnp.maximum(jnp.searchsorted(table.t, time, side="right") - 1, 0)
    s = jax.tree.map(lambda column: column[index], table)
    return move_within(rig, integrator, s, time)


def simulate(
    rig: Rig,
    velocity: Float[Array, ""] | float,
    *,
    stroke: Float[ArrayLike, ""] | None = None,
    mass: Float[ArrayLike, ""] | None = None,
    mu_s: Float[ArrayLike, ""] | None = None,
    integrator: Integrator | None = None,
) -> Trajectory:
    """One push at `velocity` [m/s], with the rig's own stroke [m], mass [kg] and mu_s unless
    given. Can be differentiated (forward mode), batched and compiled.

    Raises `InputError` for a value outside its range and in 32-bit mode.
    """
    rig = parameters.override(rig, {"mass_kg": mass, "mu_s": mu_s}, stroke)
    check_rig(rig)
    if not isinstance(velocity, Tracer):
        if isinstance(velocity, str) or np.ndim(velocity) != 0:
            raise InputError(
                f"velocity: expected one number [m/s], got {velocity!r}; jax.vmap gives several"
            )
        if not 0 < float(velocity) < np.inf:
            raise InputError(f"velocity: expected a number > 0, got {velocity}")
    push = Push.of(rig, velocity, integrator)
    arrays = pytrees.as_arrays((push.rig, push.velocity))
    return _follow(push._replace(rig=arrays[0], velocity=arrays[1]))


@cache_program
def _follow(push: Push) -> Trajectory:
    return Trajectory.of(push)
