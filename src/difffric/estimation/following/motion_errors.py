"""What the error of a recorded motion does to a push, and residuals that are blind to it.

A smoothed motion may be off in some dozens of independent ways, its modes. Each moves the model's
force and position over the whole push: through the contact, the release and every contact after it.
A push is followed with each of them, and what they do, over the noise, are the columns of D.
Residuals multiplied by (1 + D D^T)^(-1/2) are then independent again, and of unit variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.compute.program_cache import cache_program
from difffric.estimation.block_means import UnevenBlocks
from difffric.estimation.residuals import TRACE_CYCLES, TRACE_STRIDES, TracePush
from difffric.measurements.recordings import Recording
from difffric.rig import parameters
from difffric.rig.pusher import RecordedMotion
from difffric.rig.rig import Rig
from difffric.simulation.segments import Push

DIRECTIONS = 16
"""Directions that residuals are blind to at most: modes that do less than the others are left
out."""
_SLIGHT = 0.03
"""Standard deviations of the noise, over all samples of a channel, that are nothing."""


class DisplacedPush(NamedTuple):
    """What each mode of a motion's error does to a push."""

    force: NDArray
    """(samples, modes) [N] at the times of the force"""
    position: NDArray
    """(samples, modes) [m] at those of the position"""


def displace_push(
    rig: Rig,
    velocity: float,
    motion: RecordedMotion,
    modes: RecordedMotion,
    t_force: NDArray,
    t_position: NDArray,
) -> DisplacedPush:
    """Follow a push with each mode of its motion's error, at the times [s] of its samples.

    A mode that leads nowhere does nothing.
    """
    given = pytrees.as_arrays((rig, velocity, motion, modes, t_force, t_position))
    force, position = _follow_modes(*given)
    return DisplacedPush(*(np.nan_to_num(np.asarray(x)).T for x in (force, position)))


@cache_program
def _follow_modes(rig: Any, velocity: Any, motion: Any, modes: Any, t_force: Any, t_x: Any) -> Any:
    """Half the difference of a push whose motion has a mode more, and one that has it less."""
    import jax
    import jax.numpy as jnp

    from difffric.simulation.stepping.integrator import RungeKutta
    from difffric.simulation.trajectory import Trajectory

    def follow(sign: Any, mode: Any) -> Any:
        moved = RecordedMotion(
            motion.corners, motion.rates + sign * mode.rates, motion.end + sign * mode.end
        )
        integrator: Any = RungeKutta()
        push = Push.of(parameters.with_stroke(rig, moved), velocity, integrator)
        return Trajectory.of(push, TRACE_CYCLES, TRACE_STRIDES).read(t_force, t_x)

    twice = jax.tree.map(lambda x: jnp.concatenate([x, x]), modes)
    n = modes.end.shape[0]
    both = jax.vmap(follow)(jnp.repeat(jnp.array([1.0, -1.0]), n), twice)
    return tuple(0.5 * (x[:n] - x[n:]) for x in both)


def blind(D: NDArray, most: int = DIRECTIONS) -> NDArray:
    """W (m, most) with 1 - W W^T = (1 + D D^T)^(-1/2), for D (m, any): what is done to whitened
    residuals, over their noise. The directions in which least is done are left out."""
    U, s, _ = np.linalg.svd(D, full_matrices=False)
    U, s = U[:, :most], s[:most]
    W = np.zeros((len(D), most))
    W[:, : len(s)] = U * np.sqrt(1.0 - 1.0 / np.sqrt(1.0 + np.where(s > _SLIGHT, s, 0.0) ** 2))
    return W


def blind_grids(
    pushes: TracePush,
    n: int,
    weights: NDArray,
    recordings: Sequence[Recording],
    rigs: Sequence[Rig] | None,
    offsets: NDArray,
) -> TracePush:
    """Even blocks blind to what the errors of n recorded motions do to the pushes of `rigs`, whose
    start offsets are (n,) [s]; as yet to nothing, where the rigs are not known (None).

    `weights` (n, 2) are 1 / standard deviation of the whitened force [N] and position [m].
    """
    force, position = pushes.force, pushes.position
    grids = [force, position if position.t is not None else position._replace(t=force.t)]
    found = [np.zeros((*grid.y.shape, DIRECTIONS)) for grid in grids]
    for i, rig in enumerate(rigs or ()):
        own = [pytrees.pick(grid, i) for grid in grids]
        times = [np.asarray(grid.t) - offsets[i] for grid in own]
        moved = _displace(rig, float(pushes.velocity[i]), recordings[i], *times)
        for j, (grid, x) in enumerate(zip(own, moved, strict=True)):
            mean = x.copy()
            mean[1:-1] += grid.curve * (x[:-2] - 2 * x[1:-1] + x[2:])
            D = weights[i, j] * _whiten(grid.a, grid.b, grid.before, mean, centred=j == 1)
            found[j][i] = blind(D)
    for x in found:  # padding is copies of the first push
        x[n:] = x[0]
    return pushes._replace(
        force=force._replace(doubt=found[0]), position=position._replace(doubt=found[1])
    )


def blind_blocks(
    blocks: tuple[UnevenBlocks, UnevenBlocks],
    velocity: NDArray,
    recordings: Sequence[Recording],
    rigs: Sequence[Rig] | None,
) -> tuple[UnevenBlocks, UnevenBlocks]:
    """Uneven blocks of force and position blind to what the errors of the recorded motions do to
    the pushes of `rigs`; as yet to nothing, where the rigs are not known (None)."""
    found = [np.zeros((*channel.y.shape, DIRECTIONS)) for channel in blocks]
    for i, rig in enumerate(rigs or ()):
        own = [pytrees.pick(channel._replace(doubt=None), i) for channel in blocks]
        moved = _displace(rig, float(velocity[i]), recordings[i], own[0].t, own[1].t)
        for j, (channel, x) in enumerate(zip(own, moved, strict=True)):
            mean = 0.5 * (x[channel.first] + x[channel.second])
            before = np.maximum(np.arange(len(mean)) - 1, 0)
            found[j][i] = blind(_whiten(channel.a, channel.b, before, mean, centred=j == 1))
    return blocks[0]._replace(doubt=found[0]), blocks[1]._replace(doubt=found[1])


def _displace(
    rig: Rig, velocity: float, recording: Recording, t_force: NDArray, t_position: NDArray
) -> DisplacedPush:
    motion = recording.motion
    return displace_push(rig, velocity, motion.law, motion.modes, t_force, t_position)


def _whiten(a: NDArray, b: NDArray, before: NDArray, x: NDArray, centred: bool) -> NDArray:
    """Columns x (m, any) made independent of each other, and without what an unknown zero can
    explain."""
    columns = np.column_stack([np.ones(len(x)), x])
    columns = a[:, None] * columns - b[:, None] * columns[before]
    one, x = columns[:, 0], columns[:, 1:]
    norm = float(one @ one)
    return x - np.outer(one, one @ x / norm) if centred and norm > 0 else x
