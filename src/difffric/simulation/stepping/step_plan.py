"""How far a step of a push is to go: to the event aimed at, or as far as the last error lets."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array

from difffric.simulation.dynamics import Course, PhasePoint
from difffric.simulation.events import Event, Mode
from difffric.simulation.stepping.state import LoopState
from difffric.simulation.stepping.transitions import Rules

_FINEST = 1.0
"""Of the push's own time, in units of the tolerance's root: no step is shorter where a law is rough
at first touch. What is left out there is less than the tolerance."""
_LONGEST = 1e3  # of the push's own time: the longest wait for a breakaway


class StepStart(NamedTuple):
    """What is known where a step starts: rates, and each guard and the force with their rates."""

    rate: PhasePoint
    guards: dict[Event, Array]
    slopes: dict[Event, Array]
    N: Array
    dN: Array


class StepPlan(NamedTuple):
    """How far a step is to go, and why."""

    h: Array
    """[s]"""
    aim: Array
    """the event that it is to end on, or `Event.NONE`"""
    aims: Array
    """whether an earlier try of the step found that event"""
    at_once: Array
    """whether it goes straight to the breakaway"""
    corner: Array | None
    """until the next corner of the pusher's speed [s]; None: it keeps one speed"""


def plan_step(rules: Rules, m: LoopState, begin: StepStart, tol: float) -> StepPlan:
    """How far: to the event aimed at; at rest straight to the breakaway, as the force grows
    now; else as far as the last step's error lets."""
    motion, c, s = rules.motion, m.course, m.s
    pusher = motion.rig.pusher
    stuck = c.mode == Mode.STUCK
    aims = m.target >= 0
    short, slope = begin.guards[Event.BREAKAWAY], begin.slopes[Event.BREAKAWAY]
    ahead = jnp.where(slope < 0, short / -slope, jnp.inf)
    longest = _LONGEST * rules.time
    wait = jnp.where(c.touching & (ahead < longest), ahead, longest)
    at_once = stuck if pusher.constant else jnp.asarray(False)
    wait = jnp.where(at_once, wait, jnp.where(stuck, jnp.minimum(wait, m.h), m.h))
    h = jnp.where(
        aims, m.h_target, jnp.minimum(wait, _limit_by_touch(rules, c, s, begin.rate.z, tol))
    )
    rests = jnp.where(stuck & c.touching, Event.BREAKAWAY, Event.NONE)
    aim = jnp.where(aims, m.target, rests)
    corner = None
    if not pusher.constant:
        corner = pusher.corner(motion.v, c.corners) - s.t
        meets = corner <= h
        h = jnp.where(meets, corner, h)
        aim = jnp.where(meets, Event.CORNER, aim)
    return StepPlan(stop_gradient(h), aim, aims, at_once, corner)


def _limit_by_touch(rules: Rules, c: Course, s: PhasePoint, w: Array, tol: float) -> Array:
    """The longest step [s] in contact. Where a law is not smooth at first touch, its
    derivatives are less so than its values: steps there shrink with the compression, which
    grows at the rate w [m/s]."""
    touched = (c.mode == Mode.CLOSING) | (c.mode == Mode.REBOUNDING)
    graded = jnp.where(w > 0, 1.5, 0.6) * s.z / jnp.maximum(jnp.abs(w), 1e-12 * rules.u_0)
    rough = touched & rules.motion.rig.contact.rough
    return jnp.where(rough, jnp.maximum(graded, _FINEST * tol**0.5 * rules.time), jnp.inf)
