"""Measured data of the plain model, made from the equations alone: rigs, pushes, noise.

Everything is drawn from the generator that is passed in, and so repeats with its seed. Arrays and
numbers are in SI units; `files` writes them in the files' units. A study draws a rig, its pushes,
and what was measured of them:

    rng = np.random.default_rng(1)
    rig = random_rig(rng)
    pushes = make_pushes(rig, rng)
    columns = measure(pushes, rng)               # a table: arrays by name
    recorded = [record(p, rng) for p in pushes]  # recordings: sampled force and position
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from tests.reference import traces

MM_MIN = 1e-3 / 60.0
SPEEDS = tuple(
    MM_MIN * v
    for v in (500, 500, 800, 800, 1000, 1000, 1500, 2000, 2500, 3000, 3500, 4000, 4500, 5000)
)
"""[m/s]: those of the practice sets, the slow ones twice"""
LONGEST = 0.3
"""how long a push is recorded [s] that has no stroke and never leaves"""


@dataclass(frozen=True)
class Rig:
    """The plain model. The stroke of a push is `stroke`, or the way made in `push_time`; with
    neither, the pusher stops at the first loss of contact."""

    m: float
    mu_s: float
    ratio: float
    k_v: float
    k: float
    b: float
    scatter: float = 0.0
    """standard deviation of log mu_s from push to push"""
    stroke: float | None = None
    push_time: float | None = None

    def stroke_at(self, v: float) -> float | None:
        return v * self.push_time if self.push_time else self.stroke

    def follow(self, v: float, mu_s: float | None = None) -> traces.Course:
        """A push at the speed v. Raises ValueError for more contacts than are followed."""
        mu_s = self.mu_s if mu_s is None else mu_s
        laws = (self.m, mu_s, self.ratio, self.k_v, self.k, self.b)
        return traces.follow(*laws, v, self.stroke_at(v), horizon=LONGEST)


def random_rig(rng: np.random.Generator, speeds: Sequence[float] = SPEEDS) -> Rig:
    """A rig for studies.

    k log-uniform over 2e5-3e6 N/m, m uniform over 5-30 kg, the damping ratio b/(2 sqrt(k m))
    uniform over 0.1-0.5, mu_s uniform over 0.08-0.25, mu_k/mu_s = 0.75. k_v: 80 % uniform over
    2-15 N s/m, 5 % zero, 5 % over 0-2, 10 % over 15-30. Scatter: 10 % none, else uniform over
    0-5 %. The stroke is the same for all pushes in 75 % of the rigs, uniform over 1-3 mm, in 15 %
    log-uniform over 0.2-1 mm, so that the pusher stops while it still pushes the part; in the
    other 10 % each push takes the same time, 25-50 ms.

    A rig is drawn anew where a push at one of the speeds makes more contacts than are followed,
    for mu_s or 1.5 or 3 standard deviations beside it: rare, none of 2000 rigs at SPEEDS.
    """
    speeds = sorted(set(speeds))
    while True:
        m, k = rng.uniform(5, 30), math.exp(rng.uniform(math.log(2e5), math.log(3e6)))
        kind = rng.random()
        low, high = (2, 15) if kind < 0.8 else (0, 0) if kind < 0.85 else (0, 2)
        low, high = (15, 30) if kind >= 0.9 else (low, high)
        rig = Rig(
            m=m,
            mu_s=rng.uniform(0.08, 0.25),
            ratio=0.75,
            k_v=rng.uniform(low, high),
            k=k,
            b=2 * rng.uniform(0.1, 0.5) * math.sqrt(k * m),
            scatter=0.0 if rng.random() < 0.1 else rng.uniform(0, 0.05),
        )
        kind = rng.random()
        if kind < 0.75:
            rig = replace(rig, stroke=rng.uniform(1e-3, 3e-3))
        elif kind < 0.9:
            rig = replace(rig, stroke=math.exp(rng.uniform(math.log(2e-4), math.log(1e-3))))
        else:
            rig = replace(rig, push_time=rng.uniform(0.025, 0.05))
        around = rig.mu_s * np.exp(rig.scatter * np.array([0, -1.5, 1.5, -3, 3]))
        try:
            for v in speeds:
                for mu_s in around if rig.scatter else around[:1]:
                    rig.follow(v, mu_s)
        except ValueError:
            continue
        return rig


def rough_guess(rig: Rig, rng: np.random.Generator, k=3.0, b=3.0, mu_s=2.0, k_v=5.0) -> Rig:
    """What an engineer would start from: k, b and mu_s off by a factor drawn log-uniformly up to
    the one given here, k_v the given value whatever the truth, the rest right."""

    def off(factor):
        return math.exp(rng.uniform(-1, 1) * math.log(factor))

    guess = replace(rig, k=rig.k * off(k), b=rig.b * off(b), k_v=k_v)
    return replace(guess, mu_s=min(rig.mu_s * off(mu_s), 0.9))


@dataclass(frozen=True)
class Push:
    """One push and its truth."""

    rig: Rig
    velocity: float
    mu_s: float
    """its own"""
    course: traces.Course
    condition: str = "A"
    order: int = 1

    @property
    def stroke(self) -> float | None:
        return self.rig.stroke_at(self.velocity)

    @property
    def peak_force(self) -> float:
        """F_p [N]"""
        return self.course.peak_force

    @property
    def sliding_distance(self) -> float:
        """d [m]; NaN where the part rests in contact, and no latch counts"""
        d = self.course.sliding_distance
        return math.nan if d is None else d


def make_pushes(
    rig: Rig,
    rng: np.random.Generator,
    n: int = 14,
    speeds: Sequence[float] = SPEEDS,
    *,
    condition: str = "A",
    first: int = 1,
    shuffled: bool = True,
) -> list[Push]:
    """n pushes: the speeds in turn, shuffled; log mu_s of each normal about log(rig.mu_s) with
    the rig's scatter, so that rig.mu_s is the median. `first` is the order of the first.

    Raises ValueError for more contacts than are followed.
    """
    speeds = np.resize(np.asarray(speeds, float), n)
    speeds = rng.permutation(speeds) if shuffled else speeds
    own = rig.mu_s * np.exp(rig.scatter * rng.standard_normal(n))
    return [
        Push(rig, float(v), float(mu_s), rig.follow(float(v), float(mu_s)), condition, first + i)
        for i, (v, mu_s) in enumerate(zip(speeds, own, strict=True))
    ]


@dataclass(frozen=True)
class Noise:
    """Of one sample: standard deviations, the AR(1) coefficient (0: white), quantisation steps
    (0: none)."""

    force: float = 0.5
    position: float = 0.3e-6
    rho: float = 0.0
    force_step: float = 0.0
    position_step: float = 20e-9

    def of_force(self, true: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return quantised(true + coloured(len(true), self.force, self.rho, rng), self.force_step)

    def of_position(self, true: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        noisy = true + coloured(len(true), self.position, self.rho, rng)
        return quantised(noisy, self.position_step)


NO_NOISE = Noise(force=0.0, position=0.0, position_step=0.0)


def coloured(n: int, sigma: float, rho: float, rng: np.random.Generator) -> np.ndarray:
    """Stationary AR(1): e_i = rho e_(i-1) + sqrt(1 - rho^2) w_i, each e_i of deviation sigma."""
    w = rng.standard_normal(n)
    w[1:] *= math.sqrt(1 - rho**2)
    return sigma * lfilter([1.0], [1.0, -rho], w)


def quantised(x: np.ndarray, step: float) -> np.ndarray:
    return step * np.round(x / step) if step else x


@dataclass(frozen=True)
class Recorded:
    """One push as sampled at `start + i dt`, relative to what the recorder takes for t = 0."""

    push: Push
    dt: float
    start: float
    force: np.ndarray
    """[N]"""
    position: np.ndarray
    """[m], from an arbitrary zero"""
    pusher: np.ndarray | None = None
    """[m], from the same zero"""
    offset: float = 0.0
    """when the pusher truly starts [s], on the recorder's clock"""

    @property
    def time(self) -> np.ndarray:
        return self.start + self.dt * np.arange(len(self.force))


def record(
    push: Push,
    rng: np.random.Generator,
    *,
    rate: float = 10e3,
    noise: Noise = Noise(),
    before: float = 0.02,
    after: float = 0.03,
    phase: float = 0.5,
    jitter: float = 0.0,
    zero: float = 0.5e-3,
    pusher: bool = False,
) -> Recorded:
    """Sample a push: `before` of quiet, then until `after` seconds of rest.

    A sample lies at t = phase / rate on the recorder's clock, half an interval after t = 0 as in
    the practice sets unless told otherwise. The recorder's t = 0 is off by a normal start offset
    of deviation `jitter` [s]. The position's zero is uniform within +-`zero` [m].
    """
    dt = 1.0 / rate
    offset = float(jitter * rng.standard_normal())
    end = push.course.end if math.isfinite(push.course.end) else LONGEST
    n_before = round(before * rate - 1e-9)
    start = (phase - n_before) * dt
    n = math.floor((end + offset + after - start) * rate + 1e-9) + 1
    force, x, y = push.course(start + dt * np.arange(n) - offset)
    origin = rng.uniform(-zero, zero)
    return Recorded(
        push,
        dt,
        start,
        noise.of_force(force, rng),
        noise.of_position(origin + x, rng),
        noise.of_position(origin + y, rng) if pusher else None,
        offset,
    )


def measure(
    pushes: Sequence[Push],
    rng: np.random.Generator,
    *,
    force_se: float = 0.5,
    distance_se: float = 0.3e-6,
    relative_distance_se: float = 0.0,
) -> dict[str, np.ndarray]:
    """A table's columns: F_p and d of each push with normal errors of the given standard errors;
    that of d is sqrt(distance_se^2 + (relative_distance_se d)^2).

    NaN where d does not exist, or is below five of its standard errors: nobody would note it down,
    and dropping only the readings that come out negative would bias the others.
    """
    F_p = np.array([p.peak_force for p in pushes])
    d = np.array([p.sliding_distance for p in pushes])
    d_se = np.hypot(distance_se, relative_distance_se * d)
    read = d + d_se * rng.standard_normal(len(d))
    strokes = [p.stroke for p in pushes]
    return {
        "velocity": np.array([p.velocity for p in pushes]),
        "peak_force": F_p + force_se * rng.standard_normal(len(F_p)),
        "sliding_distance": np.where(d >= 5 * d_se, read, np.nan),
        "mass": np.array([p.rig.m for p in pushes]),
        "stroke": np.array([np.nan if s is None else s for s in strokes]),
        "condition": np.array([p.condition for p in pushes]),
        "order": np.array([float(p.order) for p in pushes]),
        "peak_force_se": np.full(len(F_p), force_se),
        "sliding_distance_se": d_se,
    }


@dataclass(frozen=True)
class Slides:
    """Free slides: a table's columns, and each slide's own mu_s."""

    columns: dict[str, np.ndarray]
    mu_s: np.ndarray


def measure_slides(
    rig: Rig,
    rng: np.random.Generator,
    n: int = 40,
    *,
    slowest: float = 0.05,
    fastest: float = 0.5,
    velocity_se: float = 0.01,
    distance_se: float = 10e-6,
    condition: str = "A",
) -> Slides:
    """Free slides from release speeds uniform over the range [m/s], speed read with a relative
    and distance with an absolute standard error [m]."""
    u = rng.uniform(slowest, fastest, n)
    own = rig.mu_s * np.exp(rig.scatter * rng.standard_normal(n))
    pairs = zip(own, u, strict=True)
    d = np.array([traces.slide(rig.m, mu_s, rig.ratio, rig.k_v, v) for mu_s, v in pairs])
    read = d + distance_se * rng.standard_normal(n)
    columns = {
        "release_velocity": u * (1 + velocity_se * rng.standard_normal(n)),
        "sliding_distance": np.where(d >= 5 * distance_se, read, np.nan),
        "mass": np.full(n, rig.m),
        "condition": np.array([condition] * n),
        "order": np.arange(1.0, n + 1),
        "release_velocity_se": velocity_se * u,
        "sliding_distance_se": np.full(n, distance_se),
    }
    return Slides(columns, own)
