"""What each kind of data asks of the model: residuals of one push and their exact Jacobian.

A push answers with rows [J | r]: r = measured - model, J its derivatives by the push's
coordinates (forward mode). Rows are in units of their channel's noise once divided by it. JAX is
imported by the methods: `following.respond_in_columns` answers likewise without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from difffric.compute import pytrees
from difffric.estimation.coordinates import START, rig_at, to_value
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.observables import observe
from difffric.simulation.oscillator import ViscousSlide
from difffric.simulation.segments import Integrator, Push

if TYPE_CHECKING:
    import jax
    from jaxtyping import Float

FORCE, DISTANCE = 0, 1
"""The channels of rows: the force sensor's and the probe's."""

Array = Any  # NumPy's outside a compiled program, JAX's within

TRACE_CYCLES = 64
"""Cycles through the modes that a fitted recording is followed for."""

TRACE_STRIDES = 512
"""Steps that it is followed for where it is integrated."""


class Rows(NamedTuple):
    """One push's rows [J | r], and what the model says besides."""

    rows: Array
    """(rows, coordinates + 1)"""
    model: Array
    """the model's (F_p, d); NaN where there is none"""
    jumps: Array
    """times [s] at which the force or its slope may jump; inf: none"""


class TablePush(NamedTuple):
    """F_p and d of one push; a NaN was not measured."""

    velocity: Array
    stroke: Array
    measured: Array
    """(2,) F_p [N], d [m]"""

    channels = (FORCE, DISTANCE)

    def respond(self, rig: Rig, integrator: Integrator, coordinates: Array) -> Rows:
        """The residuals of F_p and d. Where the model's part never leaves the tip it slides no
        distance: d counts as 0. What was not measured has a residual and derivatives of 0."""
        import jax
        import jax.numpy as jnp

        def compare(c: Array) -> Any:
            seen = observe(set_stroke(rig_at(rig, c), self.stroke), self.velocity, integrator)
            model = jnp.stack([seen.peak_force, seen.sliding_distance])
            reached = jnp.where(jnp.isnan(model), 0.0, model)
            r = jnp.where(jnp.isnan(self.measured), 0.0, self.measured - reached)
            return r, (r, model)

        jacobian, (r, model) = jax.jacfwd(compare, has_aux=True)(coordinates)
        jacobian = jnp.where(jnp.isnan(jacobian), 0.0, jacobian)
        return Rows(jnp.column_stack([jacobian, r]), model, jnp.full(1, jnp.inf))


class SlidePush(NamedTuple):
    """The distance of one free slide from its release speed: friction alone is modelled."""

    release_velocity: Array
    measured: Array
    """(1,) d [m]"""

    channels = (DISTANCE,)

    def respond(self, rig: Rig, integrator: Integrator, coordinates: Array) -> Rows:
        """Residual of d, `ViscousSlide.rest` of equation (2) without contact."""
        import jax
        import jax.numpy as jnp

        def compare(c: Array) -> Any:
            at = rig_at(rig, c)
            slide = ViscousSlide(-at.free(0.0), -jax.jacfwd(at.free)(0.0))
            d = slide.rest(self.release_velocity)[1]
            r = jnp.where(jnp.isnan(self.measured), 0.0, self.measured - d)
            return r, (r, jnp.stack([jnp.nan, d]))

        jacobian, (r, model) = jax.jacfwd(compare, has_aux=True)(coordinates)
        return Rows(jnp.column_stack([jacobian, r]), model, jnp.full(1, jnp.inf))


class Grid(NamedTuple):
    """One channel of one push on an even grid of block means, ready to be compared.

    The noise is whitened across gaps: a_j r_j - b_j r_before(j) has the channel's variance
    and no correlation; a = b = 0 where a sample is left out. `curve` turns a model's value at
    the middle of a block into its mean over the block, by the second difference.
    """

    t: Array | None
    """None: the force's"""
    y: Array
    """measured means"""
    a: Array
    b: Array
    before: Array
    """the index of the sample before, across gaps"""
    curve: Array
    """(): 1/24 of a block's squared length over the squared step, 0 for single samples"""
    doubt: Array | None = None
    """(m, any) W, where something besides noise is not known of the model: whitened (and centred)
    residuals r are taken as r - W (W^T r). None: nothing"""


class TracePush(NamedTuple):
    """Force and position of one recorded push. The position's zero is arbitrary: its rows have
    their mean projected out."""

    velocity: Array
    stroke: Array
    """[m], or the tip's recorded motion"""
    force: Grid
    position: Grid

    channels = (FORCE, DISTANCE)

    def respond(self, rig: Rig, integrator: Integrator, coordinates: Array) -> Rows:
        """The residuals of all samples, as the triangular factor of their [J | r], a channel after
        the other: a few rows with the same normal equations and the same sum of squares."""
        import jax
        import jax.numpy as jnp

        from difffric.simulation.trajectory import Trajectory

        def compare(c: Array) -> Any:
            at = set_stroke(rig_at(rig, c), self.stroke)
            push = Push.of(at, self.velocity, integrator)
            trajectory = Trajectory.of(pytrees.as_arrays(push), TRACE_CYCLES, TRACE_STRIDES)
            offset = to_value(START, c[-1])
            t_force = jnp.asarray(self.force.t) - offset
            own = self.position.t
            t_position = t_force if own is None else own - offset
            force, position = trajectory.read(t_force, t_position)
            rows = (
                _whiten_residuals(self.force, force),
                _centre_residuals(self.position, position),
            )
            seen = trajectory.observables
            model = jnp.stack([seen.peak_force, seen.sliding_distance])
            return rows, (rows, model, trajectory.segments.t + offset)

        jacobian, (rows, model, jumps) = jax.jacfwd(compare, has_aux=True)(coordinates)
        factors = [_factorise(J, r) for J, r in zip(jacobian, rows, strict=True)]
        return Rows(jnp.concatenate(factors), model, jumps)


def _factorise(
    jacobian: Float[jax.Array, "samples coordinates"], r: Float[jax.Array, " samples"]
) -> Float[jax.Array, "rows rows"]:
    """The triangular factor of [J | r] by modified Gram-Schmidt.

    It is as accurate as Householder's, its diagonal is not negative, so that it is continuous, and
    it needs no call to LAPACK, which may block when it is called for many pushes at once.
    """
    import jax
    import jax.numpy as jnp

    A = jnp.column_stack([jacobian, r])
    size = A.shape[1]

    def column(j, state):
        A, R = state
        a = A[:, j]
        norm = jnp.sqrt(jnp.sum(a**2))
        q = a / jnp.where(norm > 0, norm, 1.0)
        row = jnp.where(jnp.arange(size) >= j, q @ A, 0.0)
        return A - q[:, None] * row, R.at[j].set(row)

    return jax.lax.fori_loop(0, size, column, (A, jnp.zeros((size, size))))[1]


def set_stroke(rig: Rig, stroke: Array) -> Rig:
    """The rig with this push's stroke [m] or recorded motion, if it has any; without one the pusher
    stops at the first loss of contact."""
    return rig if rig.pusher.stroke is None else parameters.with_stroke(rig, stroke)


def _average_blocks(grid: Grid, model: Array) -> Array:
    """The model's means over blocks, from its values in their middles."""
    bend = model[:-2] - 2 * model[1:-1] + model[2:]
    return model.at[1:-1].add(grid.curve * bend)


def _whiten(grid: Grid, x: Array) -> Array:
    """Residuals of a channel made independent of each other."""
    return grid.a * x - grid.b * x[grid.before]


def _whiten_residuals(grid: Grid, model: Array) -> Array:
    """Measured less model, made independent."""
    return _take_doubt(grid, _whiten(grid, grid.y - _average_blocks(grid, model)))


def _take_doubt(grid: Grid, r: Array) -> Array:
    """Whitened residuals made blind, in proportion, to what is not known."""
    return r if grid.doubt is None else r - grid.doubt @ (grid.doubt.T @ r)


def _centre_residuals(grid: Grid, model: Array) -> Array:
    """Measured less model, made independent, less what an unknown zero can explain."""
    import jax.numpy as jnp

    r = _whiten(grid, grid.y - _average_blocks(grid, model))
    one = _whiten(grid, jnp.ones_like(grid.y))
    norm = jnp.sum(one**2)
    r = r - one * (jnp.sum(one * r) / jnp.where(norm > 0, norm, 1.0))
    return _take_doubt(grid, r)
