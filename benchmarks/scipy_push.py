"""What one writes without this library: one push by `scipy.integrate.solve_ivp` with events.

Equations (1) and (2), a right-hand side for each mode, derivatives by central differences.
"""

from __future__ import annotations

from math import inf, log, nan, pi, sqrt

from scipy.integrate import solve_ivp
from scipy.optimize import brentq

G = 9.80665
MAX_CONTACTS = 16
_STEP = 5e-4
"""Relative step of the central differences: about the cube root of the simulation's noise."""


def _event(function, direction, terminal=True):
    function.direction, function.terminal = direction, terminal
    return function


def push(v, mu_s, k, b, k_v, m, ratio, stroke=inf, rtol=1e-10):
    """(F_p, d): d is NaN where the part ends in contact, or is never released."""
    static, kinetic = mu_s * m * G, ratio * mu_s * m * G
    period = 2 * pi * sqrt(m / k)
    t, z, u, v_p, t_stop = 0.0, 0.0, 0.0, v, stroke / v
    mode, F_p, d, contacts = "stuck", 0.0, nan, 1

    def approach(z, u):
        return b * (v_p - u) + k * z

    def rebound(z, u):
        return k * z

    def free(z, u):
        return 0.0

    def force_rate(_, s):
        return k * (v_p - s[1]) - b * (approach(*s) - kinetic - k_v * s[1]) / m

    def gap(at, s):
        # Its root at the release is divided out, or it would fire at once.
        return s[0] / (at - t) if at > t else v_p - u

    peaks = _event(force_rate, -1, terminal=False)
    turns = _event(lambda _, s: v_p - s[1], -1)
    turns_back = _event(lambda _, s: v_p - s[1], 1)
    halts = _event(lambda _, s: s[1], -1)
    lost = _event(lambda _, s: s[0], -1)
    caught = _event(gap, 1)

    def follow(force, events, limit, max_step):
        """One mode, up to its first terminal event or the pusher's stop."""

        def rates(_, s):
            return [v_p - s[1], (force(s[0], s[1]) - kinetic - k_v * s[1]) / m]

        leg = solve_ivp(
            rates,
            (t, min(t + limit, t_stop if v_p > 0 else inf)),
            [z, u],
            method="DOP853",
            rtol=rtol,
            atol=1e-14,
            max_step=max_step,
            events=events,
        )
        return leg.t[-1], *leg.y[:, -1], [hits.size > 0 for hits in leg.t_events], leg.y_events

    while mode != "rest" and contacts <= MAX_CONTACTS:
        if mode == "stuck" and v_p == 0:
            mode = "rest"
        elif mode == "stuck":
            slip = max(0.0, (static - b * v_p) / k)
            slips = t + max(0.0, slip - z) / v_p
            touches = z < 0 <= z + v_p * (min(slips, t_stop) - t)
            if touches:
                contacts, d = contacts + 1, nan
            if slips <= t_stop:
                t, z, mode = slips, max(z, slip), "closing"
            else:
                t, z, v_p, mode = t_stop, z + v_p * (t_stop - t), 0.0, "rest"
                F_p = max(F_p, b * v + k * z if z >= 0 else 0.0)
        elif mode == "closing":
            F_p = max(F_p, approach(z, u))
            t, z, u, fired, states = follow(
                approach, [turns, halts, peaks], 60 * period, period / 8
            )
            F_p = max(F_p, approach(z, u), *(approach(*s) for s in states[2]))
            if fired[0]:
                u, mode = v_p, "rebounding"
            elif fired[1]:
                u, mode = 0.0, "stuck"
            elif t == t_stop:
                v_p, mode = 0.0, "rebounding"
            else:
                break  # steady sliding in contact
        elif mode == "rebounding":
            t, z, u, fired, _ = follow(rebound, [lost, turns_back], 60 * period, period / 8)
            if fired[0]:
                z, d, mode = 0.0, 0.0, "free"
                v_p = 0.0 if stroke == inf else v_p
            elif fired[1] and v_p > 0 and stroke < inf:
                u, mode = v_p, "closing"
            elif t == t_stop:
                v_p = 0.0
            else:
                break  # to rest in contact; or never released, energy only falls
        else:
            x = v_p * t - z
            now, z, u, fired, _ = follow(free, [halts, caught], 2 * m * u / kinetic, inf)
            t, d = now, d + v_p * now - z - x
            if fired[1]:
                z, d, contacts, mode = 0.0, nan, contacts + 1, "closing"
            elif fired[0]:
                u, mode = 0.0, "stuck"
            else:
                v_p = 0.0
    return (nan, nan) if contacts > MAX_CONTACTS else (float(F_p), float(d))


def with_derivative(v, mu_s, *others, **options):
    """(F_p, d, dF_p/dmu_s, dd/dmu_s)."""
    h = _STEP * mu_s
    (F_1, d_1), (F_2, d_2) = (push(v, mu_s + s, *others, **options) for s in (-h, h))
    F_p, d = push(v, mu_s, *others, **options)
    return F_p, d, (F_2 - F_1) / (2 * h), (d_2 - d_1) / (2 * h)


def invert(push, index, target, bracket):
    """mu_s by Brent's method: `push(mu_s)` gives (F_p, d), `index` says which is measured.

    On the logarithms, in which both are nearly straight; no d counts as a small one.
    """

    def excess(log_mu_s):
        value = push(2.718281828459045**log_mu_s)[index]
        return log(value / target) if value == value else -1.0

    return 2.718281828459045 ** brentq(excess, log(bracket[0]), log(bracket[1]), xtol=1e-12)
