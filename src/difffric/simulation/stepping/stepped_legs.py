"""Legs where friction bends with the speed, by plain NumPy: nothing is compiled, no JAX is needed.

`SteppedLegs` is the closed form's sister: what that solves on paper it steps through
(`column_steps`).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from difffric.compute import arrays as xp
from difffric.compute.dual_numbers import Dual, new_level, plain, split
from difffric.errors import InputError
from difffric.rig.number import Number, Truth
from difffric.rig.rig import Rig
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.events import Event
from difffric.simulation.force_latch import ForceFall
from difffric.simulation.leg import Leg
from difffric.simulation.stepping.column_steps import (
    LegCourse,
    LegEnd,
    LegGuard,
    LegMode,
    find_root,
    follow_leg,
    take_step,
)

_LOOSER = 30.0
"""How many times as much a step of a free slide may err: nothing amplifies it."""
_ROUNDING = 1e-11
"""A force below zero by less than this share of friction's is none."""


class SteppedLegs(ClosedForm):
    """Equation (2) where the contact is affine and friction bends with the speed alone."""

    def check(self, rig: Rig) -> None:
        """Raise `InputError` where the rig asks for more."""
        if not rig.bends_smoothly:
            raise InputError(
                "stepped legs need an affine contact, a pusher of constant speed, and friction "
                f"that is smooth in the speed; {type(rig.friction).__name__} with "
                f"{type(rig.contact).__name__} is not such"
            )

    def follow_closing(
        self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number, may_halt: bool
    ) -> Leg:
        """The tip closes in on the part, until w = 0, the part halts or the pusher stops."""
        halting = (LegGuard(Event.HALT, _halting),) if may_halt else ()
        damped = np.any(plain(_find_damping(rig, v_p)) > 0)  # else it is highest at the turn
        rising = _rising if damped else None
        mode = LegMode(_approach, (LegGuard(Event.TURN, _turning), *halting), rising=rising)
        course = LegCourse.of(rig, u, v_p, left)
        end = follow_leg(mode, course, z, u)
        u_1 = _settle_speed(end, v_p)
        at_end = rig.contact.approach(end.z, v_p - u_1)
        peak = rig.contact.approach(z, v_p - u)
        for force in (xp.where(np.isfinite(plain(end.dt)), at_end, 0.0), _find_summit(course, end)):
            peak = xp.where(force > peak, force, peak)
        return Leg(end.dt, end.event, end.z, u_1, 0.0, peak)

    def follow_rebounding(self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number) -> Leg:
        """The part recedes from the tip, until release, w = 0 or the pusher's stop."""
        mode = LegMode(
            _rebound, (LegGuard(Event.RELEASE, _parting), LegGuard(Event.TURN, _returning))
        )
        course = LegCourse.of(rig, u, v_p, left)
        # Where the tip has just stopped a damper may pull at once. (By more than the rounding of a
        # part that was caught on this very edge.)
        least = -_ROUNDING * plain(rig.friction.breakaway(rig.F_N))
        gone = plain(rig.contact.rebound(z, v_p - u)) < least
        end = follow_leg(mode, course._replace(until=xp.where(gone, 0.0, left)), z, u)
        u_1 = _settle_speed(end, v_p)
        edge = -_find_lever(rig, v_p) * (v_p - u_1)
        z_1 = xp.where(end.event == Event.RELEASE, edge, end.z)
        event = np.where(gone, int(Event.RELEASE), end.event)
        dt, z_1, u_1 = (xp.where(gone, *x) for x in ((0.0, end.dt), (z, z_1), (u, u_1)))
        return Leg(dt, event, z_1, u_1, 0.0, 0.0)

    def follow_free(
        self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number, may_catch: bool
    ) -> Leg:
        """The part slides without contact, until rest, the pusher's stop or the next contact."""
        guards = (LegGuard(Event.HALT, _halting),)
        if may_catch:
            guards = (LegGuard(Event.CATCH, _reaching, lambda z, _: z <= 0), *guards)
        if may_catch and rig.contact.parts_early:
            guards = (LegGuard(Event.CATCH, _gripping, within=True), *guards)
        mode = LegMode(_slide, guards, looser=_LOOSER, may_be_steady=False)
        end = follow_leg(mode, LegCourse.of(rig, u, v_p, left if may_catch else np.inf), z, u)
        u_1, caught = _settle_speed(end, v_p), end.event == Event.CATCH
        z_1 = xp.where(caught, xp.where(plain(end.z) > self._find_reach(rig), end.z, 0.0), end.z)
        return Leg(end.dt, end.event, z_1, u_1, z + v_p * end.dt - end.z, 0.0)

    def _find_reach(self, rig: Rig) -> Any:
        """A compression [m] below which there is none but by rounding."""
        course = LegCourse.of(rig, 0.0, 0.0, 0.0)
        return _ROUNDING * course.z_ref

    def find_force_fall(
        self, rig: Rig, closing: bool, z: Number, u: Number, v_p: Number, dt: Number
    ) -> ForceFall:
        """How the force goes along a pushed leg of dt [s], beside the threshold of the probe's
        latch; where it falls through it, `last` is the force there."""
        law = rig.contact.approach if closing else rig.contact.rebound
        guard = LegGuard(Event.FORCE_PEAK, partial(_falling, closing), lambda _, above: above >= 0)
        mode = LegMode(_approach if closing else _rebound, (guard,))
        end = follow_leg(mode, LegCourse.of(rig, u, v_p, xp.where(xp.isfinite(dt), dt, 0.0)), z, u)
        time = xp.where(end.event == Event.FORCE_PEAK, end.dt, np.inf)
        return ForceFall(law(z, v_p - u), law(end.z, v_p - end.u), time)

    def evaluate_pushed(
        self, rig: Rig, closing: Truth, z: Number, u: Number, v_p: Number, t: Number
    ) -> tuple[Any, Any]:
        """(z, u) at the time t into a pushed leg; all lanes close in, or none does."""
        mode = LegMode(_approach if np.all(closing) else _rebound)
        end = follow_leg(mode, LegCourse.of(rig, u, v_p, t), z, u)
        return end.z, end.u

    def evaluate_free(self, rig: Rig, u: Number, t: Number) -> tuple[Any, Any]:
        """(distance, u) at the time t into a free leg."""
        end = follow_leg(LegMode(_slide, may_be_steady=False), LegCourse.of(rig, u, 0.0, t), 0.0, u)
        return -end.z, end.u


def _approach(course: LegCourse, z: Any, u: Any) -> Any:
    return course.rig.approaching(z, course.v_p - u, u)


def _rebound(course: LegCourse, z: Any, u: Any) -> Any:
    return course.rig.rebounding(z, course.v_p - u, u)


def _slide(course: LegCourse, z: Any, u: Any) -> Any:
    return course.rig.free(u)


def _turning(course: LegCourse, z: Any, u: Any, a: Any) -> tuple[Any, Any]:
    """A closing ends where the part is as fast as the tip."""
    return course.v_p - u, -a


def _returning(course: LegCourse, z: Any, u: Any, a: Any) -> tuple[Any, Any]:
    """A rebound ends there too."""
    return u - course.v_p, a


def _halting(course: LegCourse, z: Any, u: Any, a: Any) -> tuple[Any, Any]:
    return u, a


def _parting(course: LegCourse, z: Any, u: Any, a: Any) -> tuple[Any, Any]:
    """Contact is lost where the force, over the stiffness, falls to zero."""
    lever, w = _find_lever(course.rig, course.v_p), course.v_p - u
    return z + lever * w, w - lever * a


def _reaching(course: LegCourse, z: Any, u: Any, a: Any) -> tuple[Any, Any]:
    """A part beyond the spring's reach is caught where it is back."""
    return -z, u - course.v_p


def _gripping(course: LegCourse, z: Any, u: Any, a: Any) -> tuple[Any, Any]:
    """A part within it is caught where a damped rebound pushes again."""
    lever, w = _find_lever(course.rig, course.v_p), course.v_p - u
    return -(z + lever * w), lever * a - w


def _falling(closing: bool, course: LegCourse, z: Any, u: Any, a: Any) -> tuple[Any, Any]:
    """The force, above the threshold of a latch."""
    rig, w = course.rig, course.v_p - u
    law = rig.contact.approach if closing else rig.contact.rebound
    by_z = xp.slope(lambda z: law(z, 0.0), course.v_p)
    by_w = xp.slope(lambda w: law(0.0, w), course.v_p)
    return law(z, w) - rig.probe.latch, by_z * w - by_w * a


def _rising(course: LegCourse, z: Any, u: Any, a: Any) -> tuple[Any, Any]:
    """The rate of a closing's force, which falls through zero at its summit."""
    w, b = course.v_p - u, _find_damping(course.rig, course.v_p)
    k = xp.slope(lambda z: course.rig.contact.approach(z, 0.0), course.v_p)
    level = new_level()
    jerk = split(_approach(course, Dual(z, w, level), Dual(u, a, level)), level)[1]
    return k * w - b * a, -k * a - b * (0.0 if jerk is None else jerk)


def _find_damping(rig: Rig, like: Any) -> Any:
    """The damping on approach [N s/m]."""
    return xp.slope(lambda w: rig.contact.approach(0.0, w), like)


def _find_lever(rig: Rig, like: Any) -> Any:
    """By how much a rebound's damper moves the edge of contact: damping over stiffness [s]."""
    stiffness = xp.slope(lambda z: rig.contact.rebound(z, 0.0), like)
    return xp.slope(lambda w: rig.contact.rebound(0.0, w), like) / stiffness


def _settle_speed(end: LegEnd, v_p: Any) -> Any:
    """The part's speed at the end of a leg, exactly that at which the event is."""
    u = xp.where(end.event == Event.TURN, v_p, end.u)
    return xp.where(end.event == Event.HALT, 0.0, u)


def _find_summit(course: LegCourse, end: LegEnd) -> Any:
    """The force [N] at its summit within a closing; 0 where there is none."""
    z, u, h = end.top
    if not np.any(h > 0):
        return 0.0
    t = find_root(_approach, _rising, course, z, u, h)
    z_1, u_1, _ = take_step(_approach, course, z, u, _approach(course, z, u), t)
    return xp.where(h > 0, course.rig.contact.approach(z_1, course.v_p - u_1), 0.0)
