"""Laws outside the catalogue, and other forms of laws in it, put around the reference's own.

Their numbers stand in p behind the reference's; all zero is the reference as it is. Lengths [m],
speeds [m/s], times [s], shares of what they act on. With a = FRICTION_RISE and so on:

- friction: mu_k L (a tanh(u / u_0) + a exp(-((u - u_0) / w)^2) + a sin(2 pi u / u_0)) more while
  sliding, the load L (1 + a exp(-x / l));
- contact: a layer of stiffness (1 - a) k down to the depth, k beyond it; a spring that softens as
  z^(1 - a); a spring force k z (1 + a w) with a hysteresis [s/m] (Hunt and Crossley);
- pusher: the tip's speed times 1 - a (travel / l), 1 - a exp(-((travel - at) / w)^2),
  1 + a exp(-t / tau) sin(2 pi f t); the ramp as an S with the same mean acceleration.
"""

from __future__ import annotations

import math

from tests.hidden import compiled

laws = compiled.module("effect_laws")
parameters = compiled.module("effect_parameters")
law = compiled.module("jit").law
(U, X, Z) = laws.U, laws.X, laws.Z
COMMAND, CONTACT, RAMP = laws.COMMAND, laws.CONTACT, laws.RAMP
ACCELERATION, K, KINETIC = parameters.ACCELERATION, parameters.K, parameters.KINETIC
LAG, SIGMA_0, SPEED = parameters.LAG, parameters.SIGMA_0, parameters.SPEED
TURN, Z_R = laws.TURN, laws.Z_R

NAMES = (
    *("friction_rise.share", "friction_rise.speed"),
    *("friction_bump.share", "friction_bump.speed", "friction_bump.width"),
    *("friction_wave.share", "friction_wave.speed"),
    *("friction_decay.share", "friction_decay.length"),
    *("soft_layer.share", "soft_layer.depth"),
    "softening.share",
    "hysteresis.per_speed",
    *("speed_sag.share", "speed_sag.length"),
    *("speed_dip.share", "speed_dip.at", "speed_dip.width"),
    *("speed_ring.share", "speed_ring.tau", "speed_ring.frequency"),
    "s_curve",
)
FIRST = parameters.SIZE
(RISE, RISE_SPEED, BUMP, BUMP_SPEED, BUMP_WIDTH, WAVE, WAVE_SPEED) = range(FIRST, FIRST + 7)
(DECAY, DECAY_LENGTH, LAYER, LAYER_DEPTH, SOFTENING, HYSTERESIS) = range(FIRST + 7, FIRST + 13)
(SAG, SAG_LENGTH, DIP, DIP_AT, DIP_WIDTH) = range(FIRST + 13, FIRST + 18)
(RING, RING_TAU, RING_FREQUENCY, S_CURVE) = range(FIRST + 18, FIRST + 22)
SIZE = FIRST + len(NAMES)
assert SIZE == S_CURVE + 1

EDGE = 0.1  # of the layer's depth: over how much it ends, or no derivative would be smooth
SOFT_FROM = 1e-5  # [m]: where the softening begins, or the stiffness at no depth would be infinite

_command, _drive_rate = laws.command, laws.drive_rate
_tip_speed, _tip_acceleration = laws.tip_speed, laws.tip_acceleration
_load, _friction, _fastest = laws.load, laws.friction, laws.fastest
_spring, _stiffness = laws.spring, laws.stiffness
_contact_force, _contact_force_rate = laws.contact_force, laws.contact_force_rate


@law
def command(t, p, mode):
    if p[S_CURVE] == 0 or mode[COMMAND] != RAMP:
        return _command(t, p, mode)
    part = t * p[ACCELERATION] / p[SPEED]
    return p[SPEED] * (2 * part * part if part < 0.5 else 1 - 2 * (1 - part) ** 2)


@law
def drive_rate(t, s, p, mode):
    if p[S_CURVE] == 0 or mode[COMMAND] != RAMP or p[LAG] > 0:
        return _drive_rate(t, s, p, mode)
    part = t * p[ACCELERATION] / p[SPEED]
    return 4 * p[ACCELERATION] * (part if part < 0.5 else 1 - part)


@law
def _dip(y, p):
    return p[DIP] * math.exp(-(((y - p[DIP_AT]) / p[DIP_WIDTH]) ** 2))


@law
def _ring(t, p):
    return p[RING] * math.exp(-t / p[RING_TAU])


@law
def unevenness(t, s, p):
    """What the tip's speed is multiplied with."""
    y, factor = laws_travel(s, p), 1.0
    if p[SAG] != 0:
        factor -= p[SAG] * y / p[SAG_LENGTH]
    if p[DIP] != 0:
        factor -= _dip(y, p)
    if p[RING] != 0:
        factor += _ring(t, p) * math.sin(TURN * p[RING_FREQUENCY] * t)
    return factor


@law
def unevenness_rate(t, s, p, speed):
    """Its rate at a speed of the tip."""
    y, rate = laws_travel(s, p), 0.0
    if p[SAG] != 0:
        rate -= p[SAG] / p[SAG_LENGTH] * speed
    if p[DIP] != 0:
        rate += _dip(y, p) * 2 * (y - p[DIP_AT]) / p[DIP_WIDTH] ** 2 * speed
    if p[RING] != 0:
        turn = TURN * p[RING_FREQUENCY]
        rate += _ring(t, p) * (turn * math.cos(turn * t) - math.sin(turn * t) / p[RING_TAU])
    return rate


@law
def tip_speed(t, s, p, mode):
    return _tip_speed(t, s, p, mode) * unevenness(t, s, p)


@law
def tip_acceleration(t, s, p, mode):
    even, factor = _tip_speed(t, s, p, mode), unevenness(t, s, p)
    return _tip_acceleration(t, s, p, mode) * factor + even * unevenness_rate(
        t, s, p, even * factor
    )


@law
def load(x, p, mode):
    here = _load(x, p, mode)
    if p[DECAY] != 0:
        here *= 1 + p[DECAY] * math.exp(-x / p[DECAY_LENGTH])
    return here


@law
def friction(s, p, mode):
    u, more = s[U], 0.0
    if p[RISE] != 0:
        more += p[RISE] * math.tanh(u / p[RISE_SPEED])
    if p[BUMP] != 0:
        more += p[BUMP] * math.exp(-(((u - p[BUMP_SPEED]) / p[BUMP_WIDTH]) ** 2))
    if p[WAVE] != 0:
        more += p[WAVE] * math.sin(TURN * u / p[WAVE_SPEED])
    if more != 0 and p[SIGMA_0] == 0:
        more *= p[KINETIC] * load(s[X], p, mode)
    return _friction(s, p, mode) + more


@law
def spring(z, p):
    if p[LAYER] != 0:
        edge = EDGE * p[LAYER_DEPTH]
        beyond = edge * math.log1p(math.exp((z - p[LAYER_DEPTH]) / edge))
        beyond -= edge * math.log1p(math.exp(-p[LAYER_DEPTH] / edge))
        return p[K] * (z - p[LAYER] * (z - beyond))
    if p[SOFTENING] != 0:
        return p[K] * z * ((1 + abs(z) / SOFT_FROM) / (1 + Z_R / SOFT_FROM)) ** -p[SOFTENING]
    return _spring(z, p)


@law
def stiffness(z, p):
    if p[LAYER] != 0:
        beyond = 1 / (1 + math.exp((p[LAYER_DEPTH] - z) / (EDGE * p[LAYER_DEPTH])))
        return p[K] * (1 - p[LAYER] * (1 - beyond))
    if p[SOFTENING] != 0:
        deep = abs(z) / SOFT_FROM
        secant = p[K] * ((1 + deep) / (1 + Z_R / SOFT_FROM)) ** -p[SOFTENING]
        return secant * (1 - p[SOFTENING] * deep / (1 + deep))
    return _stiffness(z, p)


@law
def contact_force(t, s, p, mode):
    force = _contact_force(t, s, p, mode)
    if p[HYSTERESIS] != 0 and mode[CONTACT] == 1:
        force += p[HYSTERESIS] * spring(s[Z], p) * (tip_speed(t, s, p, mode) - s[U])
    return force


@law
def contact_force_rate(t, s, p, mode):
    rate = _contact_force_rate(t, s, p, mode)
    if p[HYSTERESIS] != 0 and mode[CONTACT] == 1:
        w = tip_speed(t, s, p, mode) - s[U]
        w_rate = tip_acceleration(t, s, p, mode) - laws_acceleration(t, s, p, mode)
        rate += p[HYSTERESIS] * (stiffness(s[Z], p) * w * w + spring(s[Z], p) * w_rate)
    return rate


@law
def fastest(s, p, mode):
    period, v = _fastest(s, p, mode), max(p[SPEED], abs(s[U]))
    if p[DIP] != 0:
        period = min(period, 4 * p[DIP_WIDTH] / v)
    if p[RING] != 0:
        period = min(period, 1 / p[RING_FREQUENCY])
    return period


laws_travel, laws_acceleration = laws.travel, laws.acceleration
for _law in (
    *(command, drive_rate, tip_speed, tip_acceleration, load, friction, spring, stiffness),
    *(contact_force, contact_force_rate, fastest),
):
    setattr(laws, _law.py_func.__name__, _law)
