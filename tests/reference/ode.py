"""One push by numerical integration: a right-hand side for each mode, events that end it.

Written from the equations alone, as a second opinion on `exact`. The state is [z, u]: compression
z = y - x and the part's speed u; the pusher's position y(t) is known, so x = y - z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.80665
MAX_CONTACTS = 16
DEADBAND = 1e-11  # of w / v, or in steady sliding rounding alone would turn the part
TOLERANCES = {"method": "DOP853", "rtol": 3e-14, "atol": [1e-19, 1e-16]}


@dataclass
class Answer:
    """F_p, d and the course of the push; traces at the times that were asked for."""

    peak_force: float | None = None
    sliding_distance: float | None = None
    regime: str | None = None
    stuck_first: bool = False
    contacts: int = 0
    modes: list[str] = field(default_factory=list)
    force: np.ndarray | None = None
    position: np.ndarray | None = None
    too_many_contacts: bool = False


def _event(function, direction, terminal=True):
    function.direction, function.terminal = direction, terminal
    return function


def _missed_dip(mode, states, times):
    """When z or u went below zero and came back within one step, unseen; else None."""
    name, i = {"rebounding": ("turn", 0), "closing": ("slowest", 1)}.get(mode, (None, 0))
    for state, time in zip(states.get(name, ()), times.get(name, ()), strict=True):
        if state[i] < 0:
            return time
    return None


def push(m, mu_s, ratio, k_v, k, b, v, stroke=None, *, times=(), settle=40.0) -> Answer:
    """Integrate one push. Where nothing ends a mode, it is followed for `settle` time constants.

    Traces of a push that never ends hold until the first rebound is over, or it is steady.
    """
    static, kinetic = mu_s * m * GRAVITY, ratio * mu_s * m * GRAVITY
    endless = stroke is None or math.isinf(stroke)
    times = np.asarray(times, float)
    out = Answer(force=np.zeros_like(times), position=np.zeros_like(times))
    out.stuck_first = b * v <= static

    t, state = 0.0, np.array([0.0, 0.0])
    t_stop, y_stop = (math.inf, math.inf) if endless else (stroke / v, stroke)
    period = 2 * math.pi * math.sqrt(m / k)
    slowest = max(period, m / (b + k_v + 1e-300), (b + k_v) / k, 2 * k_v / k)
    peak, lost_x, lost_moving, in_contact = 0.0, None, None, True
    moving = True

    def pusher(time):
        return np.minimum(v * time, y_stop)

    def touch():
        out.contacts += 1
        return "closing" if state[1] > 0 or b * v > static else "stuck"

    mode = touch()
    while mode != "rest":
        if out.contacts > MAX_CONTACTS:
            out.too_many_contacts = True
            return out
        speed = v if moving else 0.0  # of the pusher, as long as this mode lasts

        def force(s, mode=mode, speed=speed):
            z, u = s
            return {
                "stuck": b * speed + k * z,
                "closing": b * (speed - u) + k * z,
                "rebounding": k * z,
            }.get(mode, 0.0 * z)

        def rates(_, s, mode=mode, speed=speed, force=force):
            if mode in ("stuck", "waiting"):
                return [speed, 0.0]
            return [speed - s[1], (force(s) - kinetic - k_v * s[1]) / m]

        events = {
            "stuck": {"slip": _event(lambda _, s: b * v + k * s[0] - static, 1)},
            "closing": {
                "turn": _event(lambda _, s: v * (1 + DEADBAND) - s[1], -1),
                "stick": _event(lambda _, s: s[1], -1),
                "slowest": _event(lambda _, s, f=rates: f(_, s)[1], 1, terminal=False),
                "peak": _event(
                    lambda _, s, f=rates: (
                        (b * f(_, s)[1] - k * f(_, s)[0]) / (b + math.sqrt(k * m))
                    ),
                    1,
                    terminal=False,
                ),
            },
            "rebounding": {
                "lost": _event(lambda _, s: s[0], -1),
                "turn": _event(lambda _, s, speed=speed: speed * (1 - DEADBAND) - s[1], 1),
            },
            "free": {
                "caught": _event(lambda _, s: s[0], 1),
                "stopped": _event(lambda _, s: s[1], -1),
            },
            "waiting": {"caught": _event(lambda _, s: s[0], 1)},
        }[mode]

        unbounded = t + settle * slowest
        if mode == "free":
            unbounded = t + 2 * m * state[1] / kinetic
        elif mode in ("stuck", "waiting"):
            unbounded = t + 2 * (static / k + abs(state[0])) / v
        longest_step = period / 8 if in_contact else math.inf
        if mode == "free" and moving:  # the gap opens at first, or the catch fires at the loss
            longest_step = (state[1] - v) * m / (kinetic + k_v * state[1]) / 2
        t_end = t_stop if moving and not endless else unbounded
        for _ in range(2):
            with np.errstate(invalid="ignore"):  # scipy's error norm is 0/0 at a full stop
                solution = solve_ivp(
                    rates,
                    (t, t_end),
                    state,
                    events=list(events.values()),
                    max_step=longest_step,
                    dense_output=len(times) > 0,
                    **TOLERANCES,
                )
            assert solution.success, solution.message
            hits = dict(zip(events, solution.y_events, strict=True))
            fired = next((n for n in events if events[n].terminal and len(hits[n])), None)
            dip = _missed_dip(mode, hits, dict(zip(events, solution.t_events, strict=True)))
            if dip is None:
                break
            t_end = dip
        out.modes.append(mode)
        candidates = [solution.y[:, 0], solution.y[:, -1], *(s for n in hits for s in hits[n])]
        peak = max(peak, *(force(s) for s in candidates))
        inside = (times >= t) & (times < solution.t[-1])
        if inside.any():
            s = solution.sol(times[inside])
            out.force[inside] = force(s)
            out.position[inside] = pusher(times[inside]) - s[0]

        t, state = solution.t[-1], solution.y[:, -1].copy()
        if fired is None:
            if moving and t == t_stop:  # the pusher stops
                moving = False
                mode = "free" if mode == "free" else "rebounding" if state[1] > 0 else "rest"
                continue
            break  # a steady state, in contact
        if fired == "slip":
            mode, state[1] = "closing", 0.0
        elif fired == "stick":
            mode, state[1] = "stuck", 0.0
        elif fired == "lost":
            lost_x, lost_moving, in_contact = pusher(t), moving, False
            state[0] = 0.0
            if endless:
                moving, y_stop = False, v * t
            mode = "free"
        elif fired == "caught":
            in_contact, state[0] = True, 0.0
            mode = touch()
        elif fired == "stopped":
            mode, state[1] = ("waiting" if moving else "rest"), 0.0
        elif mode == "closing":
            mode = "rebounding"
        elif moving and endless:  # the first rebound did not separate, and no later one will
            break
        elif moving:
            mode = "closing"
        else:
            mode = "rest"

    after = times >= t
    x = pusher(t) - state[0]
    out.position[after] = x
    out.force[after] = k * state[0] if in_contact else 0.0
    out.peak_force = float(peak)
    if not in_contact:
        out.sliding_distance = float(x - lost_x)
        out.regime = "released_by_rebound" if lost_moving else "released_at_stop"
    else:
        out.regime = "pushed_to_rest" if "closing" in out.modes else "no_motion"
    return out
