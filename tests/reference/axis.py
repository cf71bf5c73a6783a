"""A servo axis by brute force: m x'' = force + offset - friction, the force held between samples.

Small Runge-Kutta steps, the moment of rest by bisection, stick and break-away by the definition.
Nothing here imports difffric.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from tests.reference.jit import jit

KEYS = [
    "mass",
    "coulomb",
    "breakaway",
    "k_v",
    "offset",
    "coulomb_share",
    "viscous_share",
    "amplitude",
    "period",
    "phase",
    "strength",
    "strength_speed",
    "v_s",
    "waviness",
    "wavelength",
    "wave_phase",
    "drag",
]
"""What `numbers` of an axis hold, in this order; an effect's first number is 0 where it is not."""
PLAIN = dict.fromkeys(KEYS, 0.0) | {"period": 1.0, "wavelength": 1.0, "strength_speed": 1.0}
SUBSTEPS = 4


@dataclass(frozen=True)
class Axis:
    """An axis with known numbers, all SI."""

    mass: float = 95.0
    coulomb: float = 20.0
    breakaway: float = 24.0
    k_v: float = 200.0
    offset: float = -3.0
    delay: float = 0.0
    effects: dict = field(default_factory=dict)

    def numbers(self) -> np.ndarray:
        plain = {k: getattr(self, k) for k in KEYS[:5]}
        return np.array([(PLAIN | plain | self.effects)[k] for k in KEYS])


@dataclass(frozen=True)
class Record:
    """What was recorded, and the truth behind it."""

    t: np.ndarray
    force: np.ndarray
    measured: np.ndarray
    stretch: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    level: np.ndarray
    """the factor of the Coulomb friction, a number a sample"""


@jit
def resist(x, u, s, level, p):
    """Friction against a motion of direction s at speed |u|, positive."""
    v = abs(u)
    coulomb = p[1] + (p[2] - p[1]) * (math.exp(-((v / p[12]) ** 2)) if p[12] > 0 else 0.0)
    coulomb *= 1.0 + p[10] * math.log(1.0 + v / p[11])
    coulomb *= 1.0 + p[13] * math.sin(2 * math.pi * x / p[14] + p[15])
    coulomb *= level * (1.0 + s * p[5])
    return coulomb + p[3] * v * (1.0 + s * p[6]) + p[16] * v * v


@jit
def drive(x, force, p):
    return force + p[4] + p[7] * math.sin(2 * math.pi * x / p[8] + p[9])


@jit
def accelerate(x, u, s, force, level, p):
    return (drive(x, force, p) - s * resist(x, u, s, level, p)) / p[0]


@jit
def advance(x, u, s, force, level, h, p):
    """One Runge-Kutta step of h in one direction of motion."""
    a1 = accelerate(x, u, s, force, level, p)
    u2 = u + h / 2 * a1
    a2 = accelerate(x + h / 2 * u, u2, s, force, level, p)
    u3 = u + h / 2 * a2
    a3 = accelerate(x + h / 2 * u2, u3, s, force, level, p)
    u4 = u + h * a3
    a4 = accelerate(x + h * u3, u4, s, force, level, p)
    return x + h / 6 * (u + 2 * u2 + 2 * u3 + u4), u + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


@jit
def hold(x, u, s, force, level, h, p):
    """The state (x, u, direction) after a time h under one force; direction 0 is stuck."""
    left = h
    while left > 0:
        if s == 0:
            pull = drive(x, force, p)
            bend = level * (1.0 + p[13] * math.sin(2 * math.pi * x / p[14] + p[15]))
            if pull > p[2] * bend * (1.0 + p[5]):
                s = 1
            elif pull < -p[2] * bend * (1.0 - p[5]):
                s = -1
            else:
                return x, 0.0, 0
        step = min(h / SUBSTEPS, left)
        x1, u1 = advance(x, u, s, force, level, step, p)
        if s * u1 > 0 or (s * u1 == 0 and u == 0):
            x, u, left = x1, u1, left - step
            continue
        low, high = 0.0, step
        for _ in range(60):
            middle = (low + high) / 2
            if s * advance(x, u, s, force, level, middle, p)[1] > 0:
                low = middle
            else:
                high = middle
        x = advance(x, u, s, force, level, high, p)[0]
        u, s, left = 0.0, 0, left - high
    return x, u, s


@jit
def follow(force, level, h, x, u, p):
    """Positions and speeds at the samples of a given force (n,)."""
    n = len(force)
    xs, us = np.empty(n), np.empty(n)
    s = 1 if u > 0 else (-1 if u < 0 else 0)
    for k in range(n):
        xs[k], us[k] = x, u
        x, u, s = hold(x, u, s, force[k], level[k], h, p)
    return xs, us


@jit
def regulate(reference, noise, disturbance, level, h, lag, gains, p):
    """The same under a PD controller that sees the noisy position and pulls the axis along."""
    n = len(reference)
    xs, us, force = np.empty(n), np.empty(n), np.empty(n)
    x, u, s = reference[0], 0.0, 0
    before = 0.0
    smooth = 0.0
    for k in range(n):
        xs[k], us[k] = x, u
        error = reference[k] - (x + noise[k])
        smooth += gains[2] * ((error - before) / h - smooth) if k > 0 else 0.0
        before = error
        force[k] = min(max(gains[0] * error + gains[1] * smooth, -gains[3]), gains[3])
        acts = force[k - lag] if k >= lag else 0.0
        x, u, s = hold(x, u, s, acts + disturbance[k], level[k], h, p)
    return xs, us, force


def make_reference(speeds, travel, h, ramp=0.15, rest=0.1):
    """To and fro over `travel`, one round a speed, with soft ramps: positions, and the rounds."""
    parts, rounds, x = [], [], 0.0
    for i, v in enumerate(speeds):
        time = travel / v + ramp
        t = np.arange(0.0, time, h)
        rising = np.clip(t / ramp, 0, 1)
        falling = np.clip((time - t) / ramp, 0, 1)
        speed = v * np.sin(np.pi / 2 * rising) ** 2 * np.sin(np.pi / 2 * falling) ** 2
        there = np.concatenate(([0.0], np.cumsum(speed[:-1]) * h))
        pause = np.full(round(rest / h), there[-1])
        back = there[-1] - there
        one = np.concatenate((there, pause, back, np.zeros(len(pause))))
        parts.append(x + one)
        rounds.append(np.full(len(one), i))
    return np.concatenate(parts), np.concatenate(rounds)


def make_noise(n, sigma, colour, generator):
    """White noise (colour 0) or a first-order one, of standard deviation sigma."""
    white = generator.normal(size=n) * sigma * math.sqrt(1 - colour**2)
    if not colour:
        return white
    out = np.empty(n)
    last = generator.normal() * sigma
    for k in range(n):
        last = colour * last + white[k]
        out[k] = last
    return out


def record(
    axis: Axis,
    *,
    speeds=(0.02, 0.05, 0.1, 0.2, 0.1, 0.05),
    travel=0.1,
    h=1e-3,
    noise=1e-6,
    colour=0.0,
    scatter=0.02,
    disturbance=0.0,
    disturbance_colour=0.98,
    bandwidth=6.0,
    seed=0,
) -> Record:
    """Drive an axis to and fro and record it; a stretch a round."""
    generator = np.random.default_rng(seed)
    reference, stretch = make_reference(speeds, travel, h)
    n = len(reference)
    level = (1 + scatter * generator.normal(size=len(speeds)))[stretch]
    encoder = make_noise(n, noise, colour, generator)
    pushes = make_noise(n, disturbance, disturbance_colour, generator)
    w = 2 * math.pi * bandwidth
    gains = np.array([axis.mass * w**2, axis.mass * 1.4 * w, 0.3, 1e9])
    lag = round(axis.delay / h)
    p = axis.numbers()
    x, u, force = regulate(reference, encoder, pushes, level, h, lag, gains, p)
    return Record(np.arange(n) * h, force, x + encoder, stretch, x, u, level)


def write_csv(path, record: Record, volts_per_newton: float | None = None, european=False) -> None:
    """The recording as the contract's table, in mm."""
    drive_name = "force_N" if volts_per_newton is None else "drive_V"
    scale = 1.0 if volts_per_newton is None else volts_per_newton
    lines = [f"time_s,{drive_name},position_mm,stretch"]
    rows = zip(record.t, record.force, record.measured, record.stretch, strict=True)
    lines += [f"{t:.6f},{scale * f:.9g},{1e3 * x:.7f},{k}" for t, f, x, k in rows]
    text = "\n".join(lines) + "\n"
    if european:
        text = text.replace(",", ";").replace(".", ",")
    path.write_text(text, encoding="utf-8")
