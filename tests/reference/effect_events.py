"""What ends a mode, where within a step it happens, and what becomes of the mode then."""

from __future__ import annotations

from .effect_laws import (
    APPROACH,
    BEYOND,
    COMMAND,
    CONTACT,
    HOLD,
    MOVED,
    SIGN,
    SLIDING,
    STOPPED,
    U,
    X,
    Z,
    acceleration,
    breakaway,
    contact_force,
    contact_force_rate,
    drive,
    reading_rate,
    spring,
    tip_acceleration,
    tip_speed,
    travel,
)
from .effect_parameters import (
    DURATION,
    INF,
    LAG,
    PATCH,
    PATCH_START,
    REBOUND,
    SIGMA_0,
    SPEED,
    STROKE,
    B,
)
from .effect_parameters import LATCH as LATCH_N
from .effect_parameters import THRESHOLD as THRESHOLD_N
from .jit import law
from .runge_kutta import WIDTH, advance

# The events, and their guards: positive within the mode, zero where they happen.
TURNED, STUCK, MET, STOP, PATCHED, SLIPPED, REVERSED = range(7)
GUARDS, RAMPED, EXPIRED = 7, 7, 8  # the last two come at a known time
# Other quantities whose roots are wanted; from SLOPE on the slopes of the guards.
READING_RATE, OVER_THRESHOLD, OVER_LATCH, FORCE_RATE, SLOPE = range(7, 12)
DEADBAND = 1e-13  # of w / v, or in steady sliding rounding alone would turn the part
# The tally: contacts, sticks, rebounds, a number for the order of events, and their count;
# whether the last loss of contact came before the stop.
CONTACTS, STICKS, REBOUNDS, ORDER, EVENTS, LOST_MOVING = range(6)


@law
def guard(which, t, s, p, mode):
    bristles = p[SIGMA_0] > 0
    if which == TURNED and mode[CONTACT] == 1 and mode[SLIDING] == 1:
        w = tip_speed(t, s, p, mode) - s[U]
        return DEADBAND * p[SPEED] + (w if mode[APPROACH] == 1 else -w)
    if which == STUCK and mode[SLIDING] == 1 and not bristles:
        return s[U]
    if which == MET and mode[CONTACT] == 0:
        if p[REBOUND] == 0 or s[Z] <= 0:
            return -s[Z]
        return -spring(s[Z], p) - p[REBOUND] * min(tip_speed(t, s, p, mode) - s[U], 0.0)
    if which == MET and mode[SLIDING] == 1 and mode[APPROACH] == 0:
        return s[Z] if p[REBOUND] == 0 else contact_force(t, s, p, mode)
    if which == STOP and mode[COMMAND] != STOPPED and p[STROKE] < INF:
        return p[STROKE] - travel(s, p) - p[LAG] * drive(t, s, p, mode)
    if which == PATCHED and p[PATCH] != 0:
        return s[X] - p[PATCH_START] if mode[BEYOND] == 1 else p[PATCH_START] - s[X]
    if which == SLIPPED and mode[CONTACT] == 1 and mode[SLIDING] == 0:
        return breakaway(s, p, mode) - contact_force(t, s, p, mode)
    if which == REVERSED and bristles and mode[SLIDING] == 1:
        return mode[SIGN] * s[U]
    return 1.0


@law
def guard_slope(which, t, s, p, mode):
    """The guard's rate of change where a dip below zero and back could hide within a step."""
    if which == TURNED and mode[CONTACT] == 1 and mode[SLIDING] == 1:
        rate = tip_acceleration(t, s, p, mode) - acceleration(t, s, p, mode)
        return rate if mode[APPROACH] == 1 else -rate
    if which == STUCK and mode[SLIDING] == 1 and p[SIGMA_0] == 0:
        return acceleration(t, s, p, mode)
    if which == MET and mode[CONTACT] == 0 and (p[REBOUND] == 0 or s[Z] <= 0):
        return s[U] - tip_speed(t, s, p, mode)
    if which == MET and mode[CONTACT] == 1 and mode[SLIDING] == 1 and mode[APPROACH] == 0:
        if p[REBOUND] == 0:
            return tip_speed(t, s, p, mode) - s[U]
        return contact_force_rate(t, s, p, mode)
    if which == SLIPPED and mode[CONTACT] == 1 and mode[SLIDING] == 0:
        return -contact_force_rate(t, s, p, mode)
    if which == REVERSED and p[SIGMA_0] > 0:
        return mode[SIGN] * acceleration(t, s, p, mode)
    return 0.0


@law
def quantity(which, t, s, p, mode):
    if which < GUARDS:
        return guard(which, t, s, p, mode)
    if which == READING_RATE:
        return reading_rate(t, s, p, mode)
    if which == OVER_THRESHOLD:
        return contact_force(t, s, p, mode) - p[THRESHOLD_N]
    if which == OVER_LATCH:
        return contact_force(t, s, p, mode) - p[LATCH_N]
    if which == FORCE_RATE:
        return contact_force_rate(t, s, p, mode)
    return guard_slope(which - SLOPE, t, s, p, mode)


@law
def root(which, t, s, lo, hi, p, mode, stages, out):
    """The step between lo and hi after which a quantity is zero; its signs differ there.

    False position with halved weights (Illinois), and bisection where that is slow.
    """
    advance(t, s, lo, p, mode, stages, out)
    f_lo = quantity(which, t + lo, out, p, mode)
    advance(t, s, hi, p, mode, stages, out)
    f_hi = quantity(which, t + hi, out, p, mode)
    side, width, h = 0, hi - lo, hi
    for i in range(200):
        if f_hi == 0:
            h = hi
            break
        if hi - lo <= WIDTH * hi:
            break
        h = (lo * f_hi - hi * f_lo) / (f_hi - f_lo)
        if i % 4 == 3 and hi - lo > 0.25 * width:
            h = (lo + hi) / 2
        if i % 4 == 3:
            width = hi - lo
        if not lo < h < hi:
            h = (lo + hi) / 2
            if not lo < h < hi:
                break
        advance(t, s, h, p, mode, stages, out)
        f = quantity(which, t + h, out, p, mode)
        if f == 0:
            break
        if (f > 0) == (f_hi > 0):
            hi, f_hi = h, f
            if side == 1:
                f_lo /= 2
            side = 1
        else:
            lo, f_lo = h, f
            if side == -1:
                f_hi /= 2
            side = -1
    return h


@law
def first_below(which, t, s, h, s_end, p, mode, stages, out):
    """Where within (0, h] a guard first falls to zero; infinity where it does not.

    A guard that begins at zero, as u does at a slip, has to rise first.
    """
    start, end = guard(which, t, s, p, mode), guard(which, t + h, s_end, p, mode)
    if end > 0:
        falls = start > 0 and guard_slope(which, t, s, p, mode) < 0
        if not (falls and guard_slope(which, t + h, s_end, p, mode) > 0):
            return INF
        h = root(SLOPE + which, t, s, 0.0, h, p, mode, stages, out)
        advance(t, s, h, p, mode, stages, out)
        if quantity(which, t + h, out, p, mode) > 0:
            return INF
    lo = 0.0
    if start <= 0:
        lo = h / 2
        for _ in range(60):
            advance(t, s, lo, p, mode, stages, out)
            if quantity(which, t + lo, out, p, mode) > 0:
                break
            lo /= 2
        else:
            return 0.0
    return root(which, t, s, lo, h, p, mode, stages, out)


@law
def slip(mode):
    mode[SLIDING] = mode[MOVED] = mode[APPROACH] = 1


@law
def touch(t, s, p, mode, tally):
    """Contact is made: the part sticks, or slides, as one on bristles always does."""
    mode[CONTACT] = 1
    tally[CONTACTS] += 1
    w = tip_speed(t, s, p, mode) - s[U]
    mode[APPROACH] = 1 if w >= 0 else 0
    if w >= 0:
        s[Z] = 0.0
    if mode[SLIDING] == 0 and (p[SIGMA_0] > 0 or p[B] * w > breakaway(s, p, mode)):
        slip(mode)


@law
def lose(t, s, p, mode, tally, loss):
    mode[CONTACT] = 0
    if p[REBOUND] == 0:
        s[Z] = 0.0
    tally[LOST_MOVING] = 1 if mode[COMMAND] != STOPPED else 0
    loss[0], loss[1] = t, s[X]
    if p[STROKE] == INF and p[DURATION] == INF:
        mode[COMMAND] = STOPPED


@law
def stop(t, s, p, mode, tally, loss):
    mode[COMMAND] = STOPPED
    if mode[CONTACT] == 1 and mode[SLIDING] == 1:
        if tip_speed(t, s, p, mode) < s[U]:
            mode[APPROACH] = 0
        if contact_force(t, s, p, mode) <= 0:  # the damper on rebound pulls off at once
            lose(t, s, p, mode, tally, loss)


@law
def happen(event, t, s, p, mode, tally, loss):
    """Changes state, mode and tally as the event does."""
    if event not in (TURNED, REVERSED):
        tally[ORDER] = (tally[ORDER] * 31 + event + 1) % 1000000007
        tally[EVENTS] += 1
    if event == TURNED:
        mode[APPROACH] = 1 - mode[APPROACH]
        tally[REBOUNDS] += 1 - mode[APPROACH]
    elif event == STUCK:
        s[U] = 0.0
        mode[SLIDING] = 0
        tally[STICKS] += 1
    elif event == MET and mode[CONTACT] == 1:
        lose(t, s, p, mode, tally, loss)
    elif event == MET:
        touch(t, s, p, mode, tally)
    elif event in (STOP, EXPIRED):
        stop(t, s, p, mode, tally, loss)
    elif event == PATCHED:
        mode[BEYOND] = 1 - mode[BEYOND]
    elif event == SLIPPED:
        slip(mode)
    elif event == REVERSED:
        s[U] = 0.0
        mode[SIGN] = -mode[SIGN]
    elif event == RAMPED:
        mode[COMMAND] = HOLD
