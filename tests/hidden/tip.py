"""How the tip of a case travels: its ramp and its ripple, integrated here by scipy alone."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from tests.hidden.case import Case, Push

KNOWN = {"pusher_ramp", "pusher_ripple"}
"""effects of a pusher that are followed here"""
STEP = 2e-4
"""[s] the longest step"""


def follow_tip(case: Case, push: Push, times: np.ndarray) -> np.ndarray:
    """The tip's travel [m] at the times [s]: 0 before the push, the stroke when it has stopped."""
    own = {name for name in case.present if name.startswith("pusher_")}
    if not own <= KNOWN or case.stroke is None or case.s_curve:
        raise NotImplementedError(f"a tip with {sorted(own)} and a stroke of {case.stroke}")
    ramp = case.present.get("pusher_ramp", {}).get("acceleration_m_per_s2", math.inf)
    ripple = case.present.get("pusher_ripple", {"amplitude": 0, "period_m": 1, "phase_rad": 0})
    wave = 2 * math.pi / ripple["period_m"]

    def rate(t, y):
        speed = push.velocity if math.isinf(ramp) else min(ramp * t, push.velocity)
        return speed * (1 + ripple["amplitude"] * np.sin(wave * y + ripple["phase_rad"]))

    def left(t, y):
        return y[0] - case.stroke

    left.terminal = True
    corner = 0.0 if math.isinf(ramp) else push.velocity / ramp
    slowest = push.velocity * (1 - abs(ripple["amplitude"]))
    span = 0.0, corner + 1.1 * case.stroke / slowest
    how = {"events": left, "dense_output": True, "max_step": STEP, "rtol": 1e-11, "atol": 1e-15}
    found = solve_ivp(rate, span, [0.0], **how)
    end = found.t_events[0][0]
    inside = found.sol(np.clip(times, 0.0, end))[0]
    return np.where(times <= 0, 0.0, np.where(times >= end, case.stroke, inside))
