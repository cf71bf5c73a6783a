"""One push with effects by numerical integration, from the equations alone.

Steps of order 8 with a smooth right-hand side a mode; an event is found by stepping anew to it.
Nothing is shared with the library. `effect_cases.npz` holds pushes that were made with it.

What was checked, and the largest relative deviation found of F_p and of d:

- without effects, against `exact` over all of cases.json that has an answer here: 2e-15, 2e-12
  (near an edge 4e-10 in d); derivatives, relative to the largest logarithmic one: 2e-12, 2e-10;
- tilt, normal_force, friction_drift, pusher_speed, initial_gap, static_dwell, the gains, offset and
  saturation, a patch or a wave that is the same everywhere, against the plain push that each then
  is: 1e-15, 1e-14; contact_hardening without damping, against conservation of energy: 6e-15;
- every effect, against `effect_naive` (equal steps of 0.1 us and plain `if`s, written apart): the
  few 1e-5 or few nm that its steps leave, and less with shorter ones;
- all stored cases with a tenth of the tolerance and steps of at most 1/150 of a period instead of
  1/60: 1e-12 (lowpass; else 2e-14), 1e-12. Bristles settled to 1e-8 instead of 1e-6: 4e-13 in d.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .effect_events import (
    CONTACTS,
    EVENTS,
    EXPIRED,
    FORCE_RATE,
    GUARDS,
    LOST_MOVING,
    ORDER,
    OVER_LATCH,
    OVER_THRESHOLD,
    RAMPED,
    READING_RATE,
    REBOUNDS,
    STICKS,
    first_below,
    happen,
    root,
    touch,
)
from .effect_laws import (
    COMMAND,
    CONTACT,
    RAMP,
    SLIDING,
    STOPPED,
    Q,
    U,
    V,
    X,
    Z,
    contact_force,
    contact_force_rate,
    fastest,
    friction,
    initial,
    rates,
    reading,
    reading_rate,
)
from .effect_parameters import (
    ACCELERATION,
    ALONG,
    DELAY,
    DURATION,
    EXPONENT,
    GAIN,
    GAP,
    INF,
    KINETIC,
    LAG,
    LATCH,
    LEVEL,
    LOAD,
    MASS,
    OFFSET,
    PROBE,
    RATE,
    SIGMA_0,
    SPEED,
    STROKE,
    THRESHOLD,
    Z_SCALE,
    K,
    prepare,
    vector,
)
from .jit import jit, law
from .runge_kutta import STAGES, advance, error, scales

MAX_CONTACTS = 16
MAX_STEPS, MAX_EVENTS = 300_000, 1000
SHARE_OF_PERIOD = 1 / 60  # a step's largest share of the fastest period, so that no dip hides
HORIZON = 60  # periods in contact after which a push without a stroke counts as endless
SETTLED = 1e-6  # of the bristles' yield; what is left then moves the part by its square
STANDS = 1e-15  # of its speed, below which a lagging tip stands
REASONS = ("", "never released", "too many contacts", "too many steps", "no loss at the threshold")
REGIMES = ("no_motion", "pushed_to_rest", "released_by_rebound", "released_at_stop")
# Columns of a run's numbers
PEAK, X_REST, X_LOSS, T_LOSS, T_REST = range(5)
# and of its counts, behind the tally of `effect_events`; LATCHED says which fall the latch took
REGIME, REASON, PEAK_CONTACT, PEAK_EVENTS, PEAK_LATE, PEAK_SAMPLE, STEPS, LATCHED = range(6, 14)


@law
def unrest(t, s, p, mode):
    """How far the part on its bristles still swings."""
    pull = (contact_force(t, s, p, mode) - friction(s, p, mode)) / p[SIGMA_0]
    return math.sqrt(pull**2 + s[U] ** 2 * p[MASS] / p[SIGMA_0])


@law
def settled(t, s, p, mode):
    """The part is at rest for good."""
    if mode[COMMAND] != STOPPED:
        return False
    reach = 2 * p[LAG] * s[V]  # of the tip that lags, a ripple included
    if p[SIGMA_0] > 0:
        swing = unrest(t, s, p, mode)
        clear = mode[CONTACT] == 1 or 2 * swing < -s[Z]
        return reach == 0 and clear and swing < SETTLED * p[KINETIC] * p[LOAD] / p[SIGMA_0]
    if mode[SLIDING] == 1:  # overdamped behind a tip that stands: the part creeps for ever
        return mode[CONTACT] == 1 and reach == 0 and s[U] < STANDS * p[SPEED]
    return reach == 0 or (mode[CONTACT] == 0 and reach < -s[Z])


@law
def consider(value, late, sample, numbers, counts):
    """The peak, and in which course of events it lies."""
    if value > numbers[PEAK]:
        if value > numbers[PEAK] + 1e-12 * abs(value):
            counts[PEAK_CONTACT], counts[PEAK_EVENTS] = counts[CONTACTS], counts[EVENTS]
            counts[PEAK_LATE], counts[PEAK_SAMPLE] = late, sample
        numbers[PEAK] = value


@law
def watch_peak(t, s, h, s_end, p, mode, stages, tmp, numbers, counts, sample):
    """The peak of the reading over a step, or over the samples in it; returns the next sample."""
    late = 1 if mode[SLIDING] == 0 and mode[COMMAND] == STOPPED else 0
    first, last = reading(t, s, p, mode), reading(t + h, s_end, p, mode)
    rise, fall = reading_rate(t, s, p, mode), reading_rate(t + h, s_end, p, mode)
    bound = max(first, last) + 0.5 * (abs(rise) + abs(fall)) * h
    if p[RATE] < INF:
        while sample / p[RATE] < t + h:
            if bound > numbers[PEAK]:
                advance(t, s, sample / p[RATE] - t, p, mode, stages, tmp)
                value = reading(sample / p[RATE], tmp, p, mode)
                consider(value, late, sample, numbers, counts)
            sample += 1
        return sample
    consider(first, late, 0, numbers, counts)
    if rise > 0 and fall < 0 and bound > numbers[PEAK]:
        top = root(READING_RATE, t, s, 0.0, h, p, mode, stages, tmp)
        advance(t, s, top, p, mode, stages, tmp)
        consider(reading(t + top, tmp, p, mode), late, 0, numbers, counts)
    consider(last, late, 0, numbers, counts)
    return sample


@law
def watch_fall(which, level, before, t, s, h, s_end, p, mode, stages, tmp, fall):
    """The contact force's last fall through a level, in a jump at a step's start or within it.

    `before` is the force at the end of the step before, `which` the quantity that is zero there.
    """
    start, end = contact_force(t, s, p, mode), contact_force(t + h, s_end, p, mode)
    if before > level and start <= level:
        fall[0], fall[1] = t, s[X]
    if end > level:
        return
    lo = 0.0
    if start <= level:
        rising = contact_force_rate(t, s, p, mode) > 0
        if not (rising and contact_force_rate(t + h, s_end, p, mode) < 0):
            return
        lo = root(FORCE_RATE, t, s, 0.0, h, p, mode, stages, tmp)
        advance(t, s, lo, p, mode, stages, tmp)
        if contact_force(t + lo, tmp, p, mode) <= level:
            return
    at = root(which, t, s, lo, h, p, mode, stages, tmp)
    advance(t, s, at, p, mode, stages, tmp)
    fall[0], fall[1] = t + at, tmp[X]


@law
def horizon(p):
    slack = p[Z_SCALE] if p[EXPONENT] == 1 else p[Z_SCALE] + 1e-3
    ramp = p[SPEED] / p[ACCELERATION]
    period = 2 * math.pi * math.sqrt(p[MASS] / p[K])
    return (p[GAP] + 10 * slack) / p[SPEED] + ramp + 10 * p[LAG] + HORIZON * period


@jit
def integrate(p, times, forces, positions):
    """The push: its numbers and counts; the filters' output and x at the times, ascending."""
    numbers = np.zeros(5)
    numbers[PEAK] = -INF
    counts = np.zeros(14, np.int64)
    s, mode = initial(p)
    s_end, tmp, loss = np.zeros(7), np.zeros(7), np.zeros(2)
    fallen, latched = np.full(2, -1.0), np.full(2, -1.0)
    stages = np.zeros((STAGES, 7))
    scale = scales(p)
    t, asked, sample, over, moved, force_before = 0.0, 0, 0, False, False, 0.0
    while asked < times.size and times[asked] < 0:
        asked += 1
    if p[GAP] == 0:
        touch(t, s, p, mode, counts)
    h_try = 1e-3 * fastest(s, p, mode)
    t_ramp, patience = p[SPEED] / p[ACCELERATION], horizon(p)
    while not (over and asked == times.size):
        if p[LAG] > 0 and mode[COMMAND] == STOPPED and s[V] < STANDS * p[SPEED]:
            s[V] = 0.0
        if not over and settled(t, s, p, mode):
            over = True
            numbers[T_REST], numbers[X_REST] = t, s[X]
            if p[SIGMA_0] > 0 and mode[CONTACT] == 0:
                numbers[X_REST] -= s[Q] + p[ALONG] / p[SIGMA_0]
            continue
        counts[STEPS] += 1
        if counts[CONTACTS] > MAX_CONTACTS:
            counts[REASON] = 2
        elif counts[STEPS] > MAX_STEPS or counts[EVENTS] > MAX_EVENTS:
            counts[REASON] = 3
        elif min(p[STROKE], p[DURATION]) == INF and mode[COMMAND] != STOPPED and t > patience:
            counts[REASON] = 1
        if counts[REASON] > 0:
            break
        until, due = (t_ramp, RAMPED) if mode[COMMAND] == RAMP else (INF, -1)
        if mode[COMMAND] != STOPPED and p[DURATION] <= until:
            until, due = p[DURATION], EXPIRED
        if t >= until:  # another event, within rounding, came with it
            happen(due, t, s, p, mode, counts, loss)
            continue

        # One step, made small enough for its error and cut where an event ends the mode.
        h = min(h_try, SHARE_OF_PERIOD * fastest(s, p, mode))
        h = min(h, until - t)
        rates(t, s, p, mode, stages[0])
        while True:
            advance(t, s, h, p, mode, stages, s_end)
            wrong = error(s, s_end, h, scale, stages)
            if wrong <= 1:
                break
            h *= max(0.2, 0.9 * wrong**-0.125)
        h_try = h * min(4.0, 0.9 * max(wrong, 1e-10) ** -0.125)
        event = due if h == until - t else -1
        for which in range(GUARDS):
            earlier = first_below(which, t, s, h, s_end, p, mode, stages, tmp)
            if earlier < INF:
                h, event = earlier, which
                advance(t, s, h, p, mode, stages, s_end)

        if p[THRESHOLD] > 0:
            level, which = p[THRESHOLD], OVER_THRESHOLD
            watch_fall(which, level, force_before, t, s, h, s_end, p, mode, stages, tmp, fallen)
        if p[LATCH] < INF and latched[0] < 0:
            level, which = p[LATCH], OVER_LATCH
            watch_fall(which, level, force_before, t, s, h, s_end, p, mode, stages, tmp, latched)
            if latched[0] >= 0:
                counts[LATCHED] = 1000 * counts[EVENTS] + counts[REBOUNDS] + 1
                counts[LATCHED] *= -1 if latched[0] == t else 1
        force_before = contact_force(t + h, s_end, p, mode)
        if not over:
            sample = watch_peak(t, s, h, s_end, p, mode, stages, tmp, numbers, counts, sample)
        while asked < times.size and times[asked] < t + h:
            advance(t, s, times[asked] - t, p, mode, stages, tmp)
            forces[asked], positions[asked] = reading(times[asked], tmp, p, mode), tmp[X]
            asked += 1

        moved = moved or mode[SLIDING] == 1
        t = until if event >= RAMPED else t + h
        s[:] = s_end
        if event >= 0:
            happen(event, t, s, p, mode, counts, loss)
            h_try = min(h_try, SHARE_OF_PERIOD / 8 * fastest(s, p, mode))
    if mode[CONTACT] == 1 or counts[CONTACTS] == 0:
        counts[REGIME] = 1 if moved else 0
    else:
        counts[REGIME] = 2 if counts[LOST_MOVING] == 1 else 3
    numbers[T_LOSS], numbers[X_LOSS] = loss[0], loss[1]
    if latched[0] >= 0:
        numbers[T_LOSS], numbers[X_LOSS] = latched[0], latched[1]
    elif p[THRESHOLD] > 0:
        numbers[T_LOSS], numbers[X_LOSS] = fallen[0], fallen[1]
        if fallen[0] < 0 and counts[REASON] == 0 and counts[REGIME] >= 2:
            counts[REASON] = 4
    return numbers, counts


@law
def as_read(force, p):
    """Gain, offset and saturation."""
    return min(max(p[GAIN] * force + p[OFFSET], -p[LEVEL]), p[LEVEL])


@jit
def answer(numbers_of):
    """F_p, d (nan where there is none) and the counts, from the vector of NAMES."""
    p = prepare(numbers_of)
    nowhere = np.zeros(0)
    numbers, counts = integrate(p, nowhere, nowhere, nowhere)
    if counts[REASON] > 0:
        return math.nan, math.nan, counts
    distance = math.nan
    if counts[REGIME] >= 2 or counts[LATCHED] != 0:  # a latch counts to rest, wherever that is
        lost = numbers[X_LOSS]
        if p[DELAY] > 0:  # the probe shows where the part was a delay ago
            when, forces, positions = np.zeros(1), np.zeros(1), np.zeros(1)
            when[0] = numbers[T_LOSS] - p[DELAY]
            integrate(p, when, forces, positions)
            lost = positions[0]
        distance = p[PROBE] * (numbers[X_REST] - lost)
    return as_read(numbers[PEAK], p), distance, counts


@dataclass(frozen=True)
class Answer:
    """F_p, d and the course of the push; where there is no answer, `reason` says why."""

    peak_force: float | None
    sliding_distance: float | None
    regime: str | None
    contacts: int
    sticks: int
    rebounds: int
    reason: str


def push(rig: dict) -> Answer:
    """One push, from names and numbers (`effect_parameters.TABLE`)."""
    force, distance, counts = answer(vector(rig))
    tally = (int(counts[CONTACTS]), int(counts[STICKS]), int(counts[REBOUNDS]))
    if counts[REASON] > 0:
        return Answer(None, None, None, *tally, REASONS[counts[REASON]])
    if math.isnan(distance):
        return Answer(force, None, REGIMES[counts[REGIME]], *tally, "rests in contact")
    return Answer(force, distance, REGIMES[counts[REGIME]], *tally, "")


def traces(rig: dict, times) -> tuple[np.ndarray, np.ndarray]:
    """The readings of force and position at the times, ascending."""
    p = prepare(vector(rig))
    times = np.asarray(times, float)
    force, position, unused = (np.zeros_like(times) for _ in range(3))
    integrate(p, times, force, unused)
    integrate(p, times - p[DELAY], unused, position)
    started = times >= 0
    read = np.array([as_read(f, p) for f in force])
    return np.where(started, read, as_read(0.0, p)), p[PROBE] * position


def signature(counts, saturated) -> tuple:
    """Within one signature the answers are smooth functions of the parameters."""
    watched = (REGIME, REASON, CONTACTS, STICKS, ORDER, PEAK_CONTACT, PEAK_EVENTS, PEAK_SAMPLE)
    return (*(int(counts[i]) for i in (*watched, LATCHED)), bool(saturated))
