"""Legs of many pushes stepped together by plain NumPy, each lane with steps of its own.

A leg is followed by steps of DOP853 until one of its guards falls through zero; the last step is
cut there. Dual numbers pass through the steps, whose lengths are held; the last one carries how the
event's time changes, so that first derivatives are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.compute import arrays as xp
from difffric.compute.dual_numbers import ListedRows, RowsOfDuals, are_simple, plain
from difffric.compute.lanes import pick_lanes, put_lanes, repeat_while, spread
from difffric.compute.pytrees import map_tree
from difffric.rig.rig import Rig
from difffric.simulation.events import Event
from difffric.simulation.stepping.dop853_tableau import ERRORS_3, ERRORS_5, STAGES, WEIGHTS

TOLERANCE = 1e-7
"""Of a step, as a share of the compression under the part's own weight and of the leg's speed."""
_FIRST = 0.2
"""The first step, in the contact's time."""
_MOST = 3000
"""Steps of one leg at most: no rig that makes sense takes a hundredth of them."""
_STEADY = 1e-9
"""Of the leg's speed: a part that differs from the tip by less, and keeps it up, slides on with
it."""
_SLOW = 0.1
"""Of the speed at which the contact swings under the part's own friction: no leg's is less."""
_SHORTEST = 1e-9
"""Of the contact's time: a guard that rises and falls within a step as short as this falls at
once."""
_EXACT, _TRIES = 1e-13, 60
"""An event's time is found to this share of its step; tries at most."""
_SQUARED, _SHRINKS = 1e-7, 1e-2
"""A step this short, as a share of the leg's, and of the one before it, is the last."""
_GUESSES = 8
"""Steps that a cubic's root is looked for with."""
_NEAR = 0.1
"""A guard that dips to less than this share of what it has at a step's ends may have fallen."""
_BEYOND = 0.02
"""A step out of the spring's reach ends no further beyond than this share of where it began."""
_NEARLY_ALL = 0.95
"""A share of a step above this is no reason to take a shorter one."""


class LegCourse(NamedTuple):
    """What holds all along a leg; each lane has its own."""

    rig: Rig
    v_p: Any
    """the tip's speed [m/s]"""
    until: Any
    """when the leg ends at the latest [s]"""
    time: Any
    """of a radian of the contact's own oscillation [s]"""
    z_ref: Any
    """the compression [m] that errors are measured by"""
    u_ref: Any
    """the speed [m/s] likewise"""

    @classmethod
    def of(cls, rig: Rig, u: Any, v_p: Any, until: Any) -> LegCourse:
        """The course of a leg that begins with the part at u [m/s]."""
        k = plain(xp.slope(lambda z: rig.contact.approach(z, 0.0), v_p))
        weight = plain(rig.friction.breakaway(rig.F_N))
        time, z_ref = np.sqrt(plain(rig.mass) / k), weight / k
        u_ref = np.maximum(np.abs(plain(u)), np.abs(plain(v_p)))
        # A part that rests behind a standing tip, but for rounding, has no speed of its own.
        return cls(rig, v_p, until, time, z_ref, np.maximum(u_ref, _SLOW * z_ref / time))


Acceleration = Callable[[LegCourse, Any, Any], Any]
"""(course, z, u) -> x'' [m/s^2] in a mode."""
Look = Callable[[LegCourse, Any, Any, Any], tuple[Any, Any]]
"""(course, z, u, x'') -> (value, its rate in time) of a guard."""


class LegGuard(NamedTuple):
    """What ends a leg: an event where a value falls through zero."""

    event: Event
    look: Look
    armed: Callable[[Any, Any], Any] | None = None
    """whether it is watched in a step that begins at (z, value); always, where there is none"""
    within: bool = False
    """whether it is watched within the spring's reach alone, z > 0"""


class LegMode(NamedTuple):
    """How a leg goes on and what ends it."""

    accelerate: Acceleration
    guards: tuple[LegGuard, ...] = ()
    """at a tie the one named first"""
    looser: float = 1.0
    """how many times as much a step may err"""
    may_be_steady: bool = True
    """whether the part may slide on with the tip for ever"""
    rising: Look | None = None
    """the rate of the force, where its summit may lie within the leg"""


class LegEnd(NamedTuple):
    """Where a leg ended."""

    dt: Any
    """[s]; infinite: nothing ends it"""
    z: Any
    u: Any
    event: Any
    top: tuple[Any, Any, Any]
    """(z, u, h) of the step in which the force is highest; h = 0: there was none"""


class _Walk(NamedTuple):
    """Where a leg stands: at the start of its next step, and in the end of its last one."""

    z: Any
    u: Any
    t: Any
    """since the leg's start [s]"""
    h: Any
    """length of that step [s]"""
    fallen: Any
    """which guards fall in it, a bit each"""
    over: Any
    steady: Any
    lost: Any
    count: Any
    top: tuple[Any, Any, Any]


def take_step(
    accelerate: Acceleration, course: LegCourse, z: Any, u: Any, a: Any, h: Any
) -> tuple[Any, Any, Any]:
    """(z, u, error) after one step of h [s] from a state whose x'' is `a`; a step's error may be
    1."""
    make_rows = RowsOfDuals if are_simple((z, u, a, h, course.v_p)) else ListedRows
    ws, rates = (make_rows((z, u, a, h, course.v_p), len(STAGES) + 1) for _ in range(2))
    ws.append(course.v_p - u)
    rates.append(a)
    for row in STAGES:
        z_i, u_i = z + h * ws.weigh(row), u + h * rates.weigh(row)
        ws.append(course.v_p - u_i)
        rates.append(accelerate(course, z_i, u_i))
    error: Any = 0.0
    for rows, scale in ((ws, course.z_ref), (rates, course.u_ref)):
        e_5, e_3 = rows.weigh_values(ERRORS_5), rows.weigh_values(ERRORS_3)
        both = np.sqrt(e_5 * e_5 + 0.01 * e_3 * e_3)
        one = plain(h) * e_5 * e_5 / np.where(both > 0, both, 1.0)
        error = np.maximum(error, np.abs(one) / (scale * TOLERANCE))
    return z + h * ws.weigh(WEIGHTS), u + h * rates.weigh(WEIGHTS), error


def follow_leg(mode: LegMode, course: LegCourse, z: Any, u: Any) -> LegEnd:
    """Follow a leg from (z, u) to its first event, at the latest to the time at which it ends."""
    given = z, u, course.v_p, course.until, course.time
    n = np.broadcast_shapes((1,), *(np.shape(plain(x)) for x in given))[0]
    zero, no = np.zeros(n), np.zeros(n, bool)
    z, u = spread((z, u), n)
    until = plain(course.until) + zero
    none = zero.astype(int)
    start = _Walk(z, u, zero, _FIRST * course.time + zero, none, no, no, no, none, top=(z, u, zero))
    walk = repeat_while(lambda w: ~w.over, partial(_walk_on, mode), start, course, until)
    return _arrive(mode, course, walk, until)


class _RootSearch(NamedTuple):
    """Where the search for a root stands, and between which times it lies."""

    t: Any
    lo: Any
    hi: Any
    last: Any
    """length of the last step [s]"""
    moves: Any
    """whether the next one is worth taking"""
    count: Any


def find_root(
    accelerate: Acceleration, look: Look, course: LegCourse, z: Any, u: Any, h: Any
) -> NDArray:
    """When a guard falls within a step of h [s] from (z, u), as a plain number, by Newton's steps
    within a bracket.

    It is exact to a share of the step and not of itself (as `event_root` has it): what lies beside
    the step's start is known no better. The search begins where a cubic through both ends falls.
    """
    firm = map_tree(plain, (course._replace(until=0.0), z, u))

    def look_at(course: LegCourse, z: Any, u: Any, t: Any) -> tuple[Any, Any]:
        z_1, u_1, _ = take_step(accelerate, course, z, u, accelerate(course, z, u), t)
        return look(course, z_1, u_1, accelerate(course, z_1, u_1))

    def improve(s: _RootSearch, firm: Any, h: NDArray) -> _RootSearch:
        course, z, u = firm
        value, rate = look_at(course, z, u, s.t)
        lo, hi = np.where(value > 0, s.t, s.lo), np.where(value > 0, s.hi, s.t)
        t = s.t - value / np.where(rate == 0, -1e-300, rate)
        t = np.where((t >= lo) & (t <= hi), t, 0.5 * (lo + hi))
        last = np.abs(t - s.t)
        # Newton's error is quadratic in its step, where steps shrink as they do at a simple root.
        arrived = (last <= _SQUARED * h) & (last <= _SHRINKS * s.last)
        return _RootSearch(t, lo, hi, last, (last > _EXACT * h) & ~arrived, s.count + 1)

    h = np.asarray(h, float)
    none = np.zeros_like(h)
    course, z, u = firm
    begin = look(course, z, u, accelerate(course, z, u))
    t = h * _find_fall(h, *begin, *look_at(course, z, u, h))
    start = _RootSearch(t, none, h, h, h > 0, np.zeros(h.shape, int))
    return repeat_while(lambda s: s.moves & (s.count < _TRIES), improve, start, firm, h).t


def _find_fall(h: NDArray, f_0: Any, d_0: Any, f_1: Any, d_1: Any) -> NDArray:
    """About the share of a step of h [s] at which the cubic falls through zero that has these
    values and slopes at its ends, and is below zero at the last."""
    rise, d_0, d_1 = f_1 - f_0, h * d_0, h * d_1
    bend, twist = 3 * rise - 2 * d_0 - d_1, d_0 + d_1 - 2 * rise
    s, lo, hi = 0.5 + 0 * h, 0 * h, 1 + 0 * h
    for _ in range(_GUESSES):
        value = f_0 + s * (d_0 + s * (bend + s * twist))
        rate = d_0 + s * (2 * bend + 3 * s * twist)
        lo, hi = np.where(value > 0, s, lo), np.where(value > 0, hi, s)
        s = s - value / np.where(rate == 0, -1e-300, rate)
        s = np.where((s > lo) & (s < hi), s, 0.5 * (lo + hi))
    return s


def _walk_on(mode: LegMode, walk: _Walk, course: LegCourse, until: NDArray) -> _Walk:
    """One step: taken, to be taken again for its error, or the last one."""
    rest = until - walk.t
    last = walk.h >= rest
    h = np.where(last, rest, walk.h)
    z, u = walk.z, walk.u
    a = mode.accelerate(course, z, u)
    z_1, u_1, error = take_step(mode.accelerate, course, z, u, a, h)
    error = error / mode.looser
    error = np.where(np.isfinite(error), error, 1e9)
    a_1 = mode.accelerate(course, z_1, u_1)
    falls = _find_fallen(mode, course, (z, u, a), (z_1, u_1, a_1), h)
    good = (error <= 1) & (falls.shorter == 1)
    fallen = np.where(good, falls.fallen, 0)
    steady = np.zeros_like(last)
    if mode.may_be_steady:
        w, slow = plain(course.v_p) - plain(u), _STEADY * course.u_ref
        steady = np.abs(w) + np.abs(plain(a)) * course.time < slow
    ends = steady | (good & ((fallen > 0) | last))
    moves = good & ~ends
    by = np.clip(0.9 * np.maximum(error, 1e-9) ** -0.125, 0.2, 4.0)
    by = np.where(good, by, falls.shorter)
    by = np.where(error > 1, np.clip(0.9 * error**-0.125, 0.1, 0.9), by)
    top = _note_summit(mode, course, walk.top, (z, u, a), (z_1, u_1, a_1), np.where(moves, h, 0.0))
    lost = walk.count + 1 >= _MOST
    return _Walk(
        z=xp.where(moves, z_1, z),
        u=xp.where(moves, u_1, u),
        t=walk.t + np.where(moves, h, 0.0),
        h=np.where(ends, h, h * by),
        fallen=np.where(steady, 0, fallen),
        over=ends | lost,
        steady=steady,
        lost=lost & ~ends,
        count=walk.count + 1,
        top=top,
    )


class _Falls(NamedTuple):
    """What guards do in a step."""

    fallen: NDArray
    """which of them fall, a bit each"""
    shorter: NDArray
    """share of the step that is to be taken first, as one falls and rises, or rises and falls,
    within it; 1: all of it"""


def _find_fallen(mode: LegMode, course: LegCourse, start: tuple, end: tuple, h: NDArray) -> _Falls:
    """Which guards fall in a step of h [s] between two states (z, u, x'')."""
    fallen, shorter = np.zeros(h.shape, int), np.ones(h.shape)
    firm = map_tree(plain, course._replace(until=0.0))
    z, *begin = (plain(x) for x in start)
    finish = [plain(x) for x in end]
    for k, guard in enumerate(mode.guards):
        before, rate = guard.look(firm, z, *begin)
        after, rate_after = guard.look(firm, *finish)
        falls = after < 0
        if guard.armed is not None:
            falls = falls & guard.armed(z, before)
        if guard.within:
            z_1 = finish[0]
            leaves = (z > 0) & (z_1 < -_BEYOND * z) & (h > _SHORTEST * course.time)
            upto = (1 + 0.5 * _BEYOND) * z / np.where(leaves, z - z_1, 1.0)
            shorter = np.minimum(shorter, np.where(leaves, upto, 1.0))
            w, w_1 = firm.v_p - begin[0], firm.v_p - finish[1]
            where, depth = _find_dip(z, h * w, z_1, h * w_1)
            dip = (z > 0) & (z_1 > 0) & (depth < _NEAR * np.minimum(z, z_1))
            shorter = np.minimum(shorter, np.where(dip, where, 1.0))
            falls = falls & (z > 0) & (z_1 > 0)
        hump = falls & (before <= 0) & (rate > 0) & (h > _SHORTEST * course.time)
        where, depth = _find_dip(before, h * rate, after, h * rate_after)
        dip = (before > 0) & (after > 0) & (depth < _NEAR * np.minimum(before, after))
        shorter = np.minimum(shorter, np.where(hump, 0.25, np.where(dip, where, 1.0)))
        fallen = fallen + (falls.astype(int) << k)
    return _Falls(fallen, np.where(shorter < _NEARLY_ALL, shorter, 1.0))


def _find_dip(f_0: NDArray, d_0: NDArray, f_1: NDArray, d_1: NDArray) -> tuple[NDArray, NDArray]:
    """(share of a step, value there) at which a cubic is least that has these values and slopes at
    the step's ends; (1, infinite) where it does not fall at first and rise at last."""
    dips = (d_0 < 0) & (d_1 > 0)
    rise = f_1 - f_0
    bend, twist = 3 * rise - 2 * d_0 - d_1, d_0 + d_1 - 2 * rise
    root = np.sqrt(np.maximum(bend**2 - 3 * twist * d_0, 0.0))
    s = np.where(dips, -d_0 / np.where(dips, bend + root, 1.0), 1.0)
    return s, np.where(dips, f_0 + s * (d_0 + s * (bend + s * twist)), np.inf)


def _note_summit(
    mode: LegMode, course: LegCourse, top: tuple, start: tuple, end: tuple, h: NDArray
) -> tuple[Any, Any, Any]:
    """The step in which the force is highest: the first, which a closing has no second of."""
    if mode.rising is None:
        return top
    before = plain(mode.rising(course, *start)[0])
    after = plain(mode.rising(course, *end)[0])
    here = (before > 0) & (after <= 0) & (h > 0) & (top[2] == 0)
    z, u, _ = start
    return xp.where(here, z, top[0]), xp.where(here, u, top[1]), xp.where(here, h, top[2])


def _arrive(mode: LegMode, course: LegCourse, walk: _Walk, until: NDArray) -> LegEnd:
    """The end of the last step, cut at the first guard that falls in it."""
    n = len(until)
    rest = until - walk.t
    stays = walk.steady | walk.lost
    h = np.where(stays, 0.0, np.where(walk.fallen > 0, walk.h, rest))
    first, event = np.full(n, np.inf), np.full(n, int(Event.STOP))
    for k, guard in enumerate(mode.guards):
        index = np.flatnonzero((walk.fallen >> k) & 1)
        if len(index):
            part = pick_lanes((course, walk.z, walk.u, walk.h), index)
            found = find_root(mode.accelerate, guard.look, *part)
            time = put_lanes(np.full(n, np.inf), index, found, n)
            event = np.where(time < first, int(guard.event), event)
            first = np.minimum(time, first)
    h = np.where(np.isfinite(first), first, h)
    z, u = walk.z, walk.u
    a = mode.accelerate(course, z, u)
    z_1, u_1, _ = take_step(mode.accelerate, course, z, u, a, h)
    a_1 = mode.accelerate(course, z_1, u_1)
    top = _note_summit(mode, course, walk.top, (z, u, a), (z_1, u_1, a_1), h)
    stops = (event == Event.STOP) & np.isfinite(until)
    # How the end's time changes with what is differentiated by.
    shift: Any = xp.where(stops, course.until - np.where(stops, until, 0.0), 0.0)
    for guard in mode.guards:
        here = event == guard.event
        if here.any():
            value, rate = guard.look(course, z_1, u_1, a_1)
            rate = plain(rate)
            late = (plain(value) - value) / np.where(rate == 0, 1.0, rate)
            shift = xp.where(here, late, shift)
    endless = walk.lost | (walk.steady & ~np.isfinite(until))
    dt = walk.t + np.where(walk.steady, np.where(endless, 0.0, rest), h) + shift
    return LegEnd(
        dt=xp.where(endless, np.inf, dt),
        z=z_1 + plain(course.v_p - u_1) * shift,
        u=u_1 + plain(a_1) * shift,
        event=np.where(endless, int(Event.NONE), event),
        top=top,
    )
