"""The laws of a push with effects, each written once: tip, friction, contact, sensor.

The state is [z, u, x, V, f, l, q]: compression z = y - x, the part's speed and position, the tip's
unrippled speed (where it lags), the states of lowpass and highpass, the bristles. `mode` holds what
is constant between two events.
"""

from __future__ import annotations

import math

import numpy as np

from .effect_parameters import (
    ACCELERATION,
    ALONG,
    DELTA,
    DRAG,
    EXPONENT,
    GAP,
    HIGHPASS,
    INF,
    K_V,
    KINETIC,
    LAG,
    LOAD,
    LOWPASS,
    MASS,
    PATCH,
    PERIOD,
    REBOUND,
    RESTED,
    RIPPLE,
    RIPPLE_PHASE,
    SIGMA_0,
    SIGMA_1,
    SPEED,
    STATIC,
    V_S,
    WAVE,
    WAVE_PHASE,
    WAVELENGTH,
    Z_SCALE,
    B,
    K,
)
from .jit import jit, law

Z, U, X, V, F, L, Q = range(7)
# mode: in contact; sliding; tip approaches (w >= 0); command; beyond the patch's start; has moved;
# sign of u (bristles only)
CONTACT, SLIDING, APPROACH, COMMAND, BEYOND, MOVED, SIGN = range(7)
RAMP, HOLD, STOPPED = range(3)
Z_R = 1e-4  # where the spring force of every exponent is k z
TURN = 2 * math.pi


@law
def command(t, p, mode):
    if mode[COMMAND] == RAMP:
        return p[ACCELERATION] * t
    return p[SPEED] if mode[COMMAND] == HOLD else 0.0


@law
def drive(t, s, p, mode):
    """V, the tip's speed but for its ripple."""
    return s[V] if p[LAG] > 0 else command(t, p, mode)


@law
def drive_rate(t, s, p, mode):
    if p[LAG] > 0:
        return (command(t, p, mode) - s[V]) / p[LAG]
    return p[ACCELERATION] if mode[COMMAND] == RAMP else 0.0


@law
def travel(s, p):
    return s[X] + s[Z] + p[GAP]


@law
def ripple_angle(s, p):
    return TURN * travel(s, p) / p[PERIOD] + p[RIPPLE_PHASE]


@law
def tip_speed(t, s, p, mode):
    speed = drive(t, s, p, mode)
    if p[RIPPLE] != 0:
        speed *= 1 + p[RIPPLE] * math.sin(ripple_angle(s, p))
    return speed


@law
def tip_acceleration(t, s, p, mode):
    rate = drive_rate(t, s, p, mode)
    if p[RIPPLE] != 0:
        angle = ripple_angle(s, p)
        rate *= 1 + p[RIPPLE] * math.sin(angle)
        slope = p[RIPPLE] * math.cos(angle) * TURN / p[PERIOD]
        rate += drive(t, s, p, mode) * slope * tip_speed(t, s, p, mode)
    return rate


@law
def load(x, p, mode):
    """Normal force with what waviness and patch make of it."""
    here = p[LOAD]
    if p[WAVE] != 0:
        here *= 1 + p[WAVE] * math.sin(TURN * x / p[WAVELENGTH] + p[WAVE_PHASE])
    if mode[BEYOND] == 1:
        here *= 1 + p[PATCH]
    return here


@law
def breakaway(s, p, mode):
    force = p[STATIC] * load(s[X], p, mode)
    if mode[MOVED] == 0:
        force *= p[RESTED]
    return force + p[ALONG]


@law
def bristle_rate(s, p, mode):
    u = s[U]
    return u - p[SIGMA_0] * mode[SIGN] * u * s[Q] / (p[KINETIC] * load(s[X], p, mode))


@law
def friction(s, p, mode):
    u = s[U]
    viscous = p[K_V] * u + p[ALONG]
    if p[SIGMA_0] > 0:
        bristles = p[SIGMA_0] * s[Q] + p[SIGMA_1] * bristle_rate(s, p, mode)
        return bristles + viscous + p[DRAG] * u * u * mode[SIGN]
    mu = p[KINETIC]
    if p[V_S] > 0:
        mu += (p[STATIC] - p[KINETIC]) * math.exp(-((abs(u) / p[V_S]) ** p[DELTA]))
    return mu * load(s[X], p, mode) + viscous + p[DRAG] * u * u


@law
def spring(z, p):
    if p[EXPONENT] == 1:
        return p[K] * z
    force = p[K] * Z_R * (abs(z) / Z_R) ** p[EXPONENT]
    return force if z > 0 else -force


@law
def stiffness(z, p):
    if p[EXPONENT] == 1:
        return p[K]
    return p[K] * p[EXPONENT] * (abs(z) / Z_R) ** (p[EXPONENT] - 1)


@law
def damping(p, mode):
    return p[B] if mode[APPROACH] == 1 else p[REBOUND]


@law
def contact_force(t, s, p, mode):
    if mode[CONTACT] == 0:
        return 0.0
    return spring(s[Z], p) + damping(p, mode) * (tip_speed(t, s, p, mode) - s[U])


@law
def acceleration(t, s, p, mode):
    if mode[SLIDING] == 0:
        return 0.0
    return (contact_force(t, s, p, mode) - friction(s, p, mode)) / p[MASS]


@law
def contact_force_rate(t, s, p, mode):
    if mode[CONTACT] == 0:
        return 0.0
    w = tip_speed(t, s, p, mode) - s[U]
    w_rate = tip_acceleration(t, s, p, mode) - acceleration(t, s, p, mode)
    return stiffness(s[Z], p) * w + damping(p, mode) * w_rate


@law
def rates(t, s, p, mode, out):
    """The right-hand side, smooth as long as `mode` lasts."""
    out[:] = 0.0
    out[Z] = tip_speed(t, s, p, mode) - s[U]
    if mode[SLIDING] == 1:
        out[U] = acceleration(t, s, p, mode)
        out[X] = s[U]
    if p[LAG] > 0:
        out[V] = drive_rate(t, s, p, mode)
    amplified = contact_force(t, s, p, mode)
    if p[LOWPASS] > 0:
        out[F] = (amplified - s[F]) / p[LOWPASS]
        amplified = s[F]
    if p[HIGHPASS] < INF:
        out[L] = (amplified - s[L]) / p[HIGHPASS]
    if p[SIGMA_0] > 0:
        out[Q] = bristle_rate(s, p, mode)


@law
def reading(t, s, p, mode):
    """What the sensor's filters make of the contact force (before gain, offset, saturation)."""
    amplified = s[F] if p[LOWPASS] > 0 else contact_force(t, s, p, mode)
    return amplified - s[L]


@law
def reading_rate(t, s, p, mode):
    if p[LOWPASS] > 0:
        rate = (contact_force(t, s, p, mode) - s[F]) / p[LOWPASS]
    else:
        rate = contact_force_rate(t, s, p, mode)
    return rate - reading(t, s, p, mode) / p[HIGHPASS]


@law
def fastest(s, p, mode):
    """The shortest period or wave that the motion holds, of which steps stay a small share."""
    v = max(p[SPEED], abs(s[U]))
    period = INF
    if mode[CONTACT] == 1:
        stiffest = p[EXPONENT] * p[K] * max(1.0, max(s[Z], p[Z_SCALE]) / Z_R) ** (p[EXPONENT] - 1)
        period = TURN * math.sqrt(p[MASS] / stiffest)
    else:
        period = 4 * TURN * math.sqrt(p[MASS] / p[K])
    if p[SIGMA_0] > 0:
        period = min(period, TURN * math.sqrt(p[MASS] / p[SIGMA_0]))
    if p[WAVE] != 0:
        period = min(period, p[WAVELENGTH] / v)
    if p[RIPPLE] != 0:
        period = min(period, p[PERIOD] / v)
    return period


@jit
def initial(p):
    """State and mode just after t = 0, before the first touch."""
    s = np.zeros(7)
    s[Z] = -p[GAP]
    mode = np.zeros(7, np.int64)
    mode[APPROACH] = mode[SIGN] = 1
    mode[COMMAND] = RAMP if p[ACCELERATION] < INF else HOLD
    if p[SIGMA_0] > 0:
        s[Q] = -p[ALONG] / p[SIGMA_0]
    return s, mode
