"""One push in closed form, in arithmetic of any precision.

Between two events a push obeys a linear equation with constant coefficients. Each mode below is
one function that writes down that solution, finds the first event that ends it, and hands the
state to the next mode:

    stuck       at rest in contact; the moving pusher loads spring and damper
    closing     sliding in contact, the pusher approaches: spring and damper act
    rebounding  sliding in contact, the part runs away from the pusher: the spring alone acts
    free        sliding without contact
    waiting     at rest without contact, the pusher still moves
    rest        the end

x is the part, y the pusher, u = x', z = y - x and w = z'. All numbers are in SI units.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mpmath

GRAVITY = 9.80665
MAX_CONTACTS = 16
INPUTS = ("m", "mu_s", "ratio", "k_v", "k", "b", "v", "stroke")
PARAMETERS = {  # name in the answers -> argument of push
    "mu_s": "mu_s",
    "mu_k_over_mu_s": "ratio",
    "k_v_N_s_per_m": "k_v",
    "k_N_per_m": "k",
    "b_N_s_per_m": "b",
    "mass_kg": "m",
    "velocity_m_per_s": "v",
}

MP = mpmath.MPContext()
MP.dps = 60

Number = Any  # an mpf of MP, or a float


@dataclass(frozen=True)
class Arithmetic:
    """Elementary functions, conversion and resolution of one kind of number."""

    fn: Any
    number: Callable[[Any], Number]
    tiny: float  # relative width at which a root is converged


EXACT = Arithmetic(MP, MP.mpf, 1e-40)
FLOAT = Arithmetic(math, float, 1e-13)


class Oscillation:
    """Solution of s'' + 2 sigma s' + omega0^2 s = 0 with s(0) = s0, s'(0) = s1."""

    def __init__(self, fn, sigma, omega0_squared, s0, s1):
        self.fn, self.sigma, self.omega0_squared = fn, sigma, omega0_squared
        self.s0, self.s1 = s0, s1
        self.lead = s1 + sigma * s0
        self.discriminant = sigma**2 - omega0_squared
        self.rate = fn.sqrt(abs(self.discriminant))

    def __call__(self, t):
        fn, rate, sigma = self.fn, self.rate, self.sigma
        if self.discriminant < 0:
            swing = self.s0 * fn.cos(rate * t) + self.lead / rate * fn.sin(rate * t)
            return fn.exp(-sigma * t) * swing
        if self.discriminant == 0:
            return fn.exp(-sigma * t) * (self.s0 + self.lead * t)
        if rate * t < 1:
            swing = self.s0 * fn.cosh(rate * t) + self.lead / rate * fn.sinh(rate * t)
            return fn.exp(-sigma * t) * swing
        fast = sigma + rate
        slow = self.omega0_squared / fast
        return (
            (self.s0 + self.lead / rate) * fn.exp(-slow * t)
            + (self.s0 - self.lead / rate) * fn.exp(-fast * t)
        ) / 2

    def derivative(self) -> Oscillation:
        """s', a solution of the same equation."""
        s2 = -2 * self.sigma * self.s1 - self.omega0_squared * self.s0
        return Oscillation(self.fn, self.sigma, self.omega0_squared, self.s1, s2)

    def combine(self, a, b) -> Oscillation:
        """a s + b s', a solution of the same equation."""
        d = self.derivative()
        s0, s1 = a * self.s0 + b * d.s0, a * self.s1 + b * d.s1
        return Oscillation(self.fn, self.sigma, self.omega0_squared, s0, s1)

    def first_zero(self):
        """First t > 0 with s(t) = 0, infinity where there is none."""
        fn, s0, lead = self.fn, self.s0, self.lead
        if s0 == 0 and lead == 0:
            return math.inf
        if self.discriminant < 0:
            if s0 == 0:
                return fn.pi / self.rate
            phase = fn.atan2(lead / self.rate, s0) + fn.pi / 2
            if phase <= 0:
                phase += fn.pi
            elif phase > fn.pi:
                phase -= fn.pi
            return phase / self.rate
        if lead == 0 or not s0 * lead < 0:
            return math.inf
        if self.discriminant == 0:
            return -s0 / lead
        tangent = -s0 * self.rate / lead
        return fn.atanh(tangent) / self.rate if tangent < 1 else math.inf


def root(f, slope, lo, hi, tiny):
    """Root of f between lo and hi, where its sign changes: Newton kept inside the bracket, which
    is halved at least every other step (near a double root Newton's steps follow the rounding)."""
    at_hi = f(hi)
    if at_hi == 0:
        return hi
    rising = at_hi > 0
    t = (lo + hi) / 2
    for step in range(1000):
        value, gradient = f(t), slope(t)
        if (value > 0) == rising:
            hi = t
        else:
            lo = t
        newton = t - value / gradient if gradient else lo
        if abs(newton - t) <= tiny * hi:
            return newton
        t = newton if step % 2 and lo < newton < hi else (lo + hi) / 2
        if hi - lo <= tiny * hi:
            return t
    raise ArithmeticError("the root did not converge")


@dataclass(frozen=True)
class State:
    """Where the part is: time, position, compression, speed, and whether the pusher moves."""

    t: Number
    x: Number
    z: Number
    u: Number
    moving: bool


@dataclass(frozen=True)
class Segment:
    """One mode from `start` on; force and position are functions of the time since then."""

    mode: str
    start: Number
    duration: Number
    force: Callable
    position: Callable
    peak: Number
    peak_at: str  # start, inside, end, or steady: approached as t goes to infinity


@dataclass(frozen=True)
class Result:
    """The answers; `too_many_contacts` is the error flag, and then nothing else counts."""

    peak_force: Number
    sliding_distance: Number | None
    regime: str | None
    stuck_first: bool
    contacts: int
    segments: tuple[Segment, ...]
    too_many_contacts: bool = False
    states: tuple[State, ...] = ()  # at the start of each segment

    @property
    def modes(self) -> tuple[str, ...]:
        return tuple(s.mode for s in self.segments)

    @property
    def outcome(self) -> tuple:
        """What `margin` watches."""
        return (self.regime, self.stuck_first, self.contacts)

    @property
    def peak_segment(self) -> int:
        """The first segment that holds the peak."""
        enough = self.peak_force * (1 - 1e-11)
        return next(i for i, s in enumerate(self.segments) if s.peak >= enough)

    @property
    def signature(self) -> tuple:
        """Within one signature the answers are analytic functions of the parameters."""
        if self.too_many_contacts:
            return self.outcome
        i = self.peak_segment
        return (*self.outcome, self.modes, i, self.segments[i].peak_at)

    def _at(self, t, what: str):
        i = bisect_right([s.start for s in self.segments], t) - 1
        return getattr(self.segments[i], what)(t - self.segments[i].start) if i >= 0 else 0 * t

    def force(self, t):
        """Contact force; at a jump, its value after it."""
        return self._at(t, "force")

    def position(self, t):
        return self._at(t, "position")


class TooManyContacts(Exception):
    pass


class _Push:
    """The modes of one push. Each takes the state and returns (segment, state, next mode)."""

    def __init__(self, arithmetic, m, mu_s, ratio, k_v, k, b, v, stroke, horizon):
        number = arithmetic.number
        self.fn, self.tiny = arithmetic.fn, arithmetic.tiny
        self.m, self.k_v, self.k, self.b, self.v = map(number, (m, k_v, k, b, v))
        self.static = number(mu_s) * self.m * number(GRAVITY)
        self.kinetic = number(ratio) * self.static
        self.endless = stroke is None or math.isinf(stroke)
        self.t_stop = math.inf if self.endless else number(stroke) / self.v
        self.horizon = horizon
        self.zero = number(0)
        self.contacts = 0
        self.lost_at = None
        self.lost_moving = True
        self.in_contact = True

    def speed(self, s: State):
        return self.v if s.moving else self.zero

    def left(self, s: State):
        return self.t_stop - s.t if s.moving else math.inf

    def touch(self, s: State):
        """Contact is made: the part sticks, or slides."""
        self.contacts += 1
        if self.contacts > MAX_CONTACTS:
            raise TooManyContacts
        return "closing" if s.u > 0 or self.b * self.v > self.static else "stuck"

    def stuck(self, s: State):
        b, k, v = self.b, self.k, self.v
        z_slip = (self.static - b * v) / k
        t_slip, left = (z_slip - s.z) / v, self.left(s)
        t = min(t_slip, left)
        force = lambda t: b * v + k * (s.z + v * t)  # noqa: E731
        seg = Segment("stuck", s.t, t, force, lambda t: s.x, force(t), "end")
        if t_slip < left:
            return seg, State(s.t + t, s.x, z_slip, self.zero, True), "closing"
        return seg, State(s.t + t, s.x, s.z + v * t, self.zero, False), "rest"

    def closing(self, s: State):
        m, k, b, v = self.m, self.k, self.b, self.v
        z_steady = (self.kinetic + self.k_v * v) / k
        sigma = (b + self.k_v) / (2 * m)
        q = Oscillation(self.fn, sigma, k / m, s.z - z_steady, v - s.u)
        w = q.derivative()
        t_turn, t_stick, left = w.first_zero(), math.inf, self.left(s)
        if s.u > 0 and w.s1 > 0:  # the part slows down at first: u = v - w may reach zero
            w_slope = w.derivative()
            t_slowest = w_slope.first_zero()
            if t_slowest < t_turn and w(t_slowest) >= v:
                t_stick = root(lambda t: w(t) - v, w_slope, self.zero, t_slowest, self.tiny)
        t = min(t_turn, t_stick, left)

        force = lambda t: b * w(t) + k * (z_steady + q(t))  # noqa: E731
        position = lambda t: s.x + s.z + v * t - z_steady - q(t)  # noqa: E731
        candidates = [(force(self.zero), "start")]
        t_peak = w.combine(k, b).first_zero()
        if b > 0 and t_peak < t:  # undamped, the peak is where it turns
            candidates.append((force(t_peak), "inside"))
        end = (k * z_steady, "steady") if t == math.inf else (force(t), "end")
        seg = Segment("closing", s.t, t, force, position, *max([*candidates, end], key=_first))

        if t == math.inf:
            return seg, s, None
        state = State(s.t + t, position(t), z_steady + q(t), v - w(t), True)
        if t == left:
            return seg, replace(state, moving=False), "rebounding"
        if t == t_stick:
            return seg, replace(state, u=self.zero), "stuck"
        return seg, replace(state, u=v), "rebounding"

    def rebounding(self, s: State):
        m, k, speed = self.m, self.k, self.speed(s)
        z_steady = (self.kinetic + self.k_v * speed) / k
        q = Oscillation(self.fn, self.k_v / (2 * m), k / m, s.z - z_steady, speed - s.u)
        w = q.derivative()
        t_turn, t_loss, left = w.first_zero(), math.inf, self.left(s)
        if t_turn < math.inf and z_steady + q(t_turn) <= 0:
            t_loss = root(lambda t: z_steady + q(t), w, self.zero, t_turn, self.tiny)
        t = min(t_turn, t_loss, left)

        force = lambda t: k * (z_steady + q(t))  # noqa: E731
        position = lambda t: s.x + s.z + speed * t - z_steady - q(t)  # noqa: E731
        seg = Segment("rebounding", s.t, t, force, position, k * s.z, "start")

        if t == math.inf:  # overdamped behind a pusher that stands: creeps to the steady force
            return seg, s, None
        state = State(s.t + t, position(t), z_steady + q(t), speed - w(t), s.moving)
        if t == left:
            return seg, replace(state, moving=False), "rebounding"
        if t == t_loss:
            self.lost_at, self.lost_moving = state.x, s.moving
            self.in_contact = False
            return seg, replace(state, z=self.zero, moving=s.moving and not self.endless), "free"
        if not s.moving:
            return seg, replace(state, u=self.zero), "rest"
        if self.endless and state.t >= self.horizon:  # later rebounds are weaker
            return seg, state, None
        return seg, replace(state, u=speed), "closing"

    def free(self, s: State):
        fn, speed = self.fn, self.speed(s)
        rate, decel = self.k_v / self.m, self.kinetic / self.m

        def travel(t):
            return s.u * _decay1(fn, rate, t) - decel * _decay2(fn, rate, t)

        def time_to(u):
            gain = (s.u - u) / (decel + rate * u)
            return gain if rate == 0 else fn.log1p(rate * gain) / rate

        def gap(t):
            return s.z + speed * t - travel(t)

        def gap_slope(t):
            return speed - s.u + (rate * s.u + decel) * _decay1(fn, rate, t)

        t_rest, left, t_catch = time_to(self.zero), self.left(s), math.inf
        t = min(t_rest, left)
        if s.moving and time_to(speed) < t and gap(t) >= 0:
            t_catch = t = root(gap, gap_slope, time_to(speed), t, self.tiny)
        x = s.x + travel(t)
        seg = Segment(
            "free", s.t, t, lambda t: self.zero, lambda t: s.x + travel(t), self.zero, "start"
        )
        state = State(s.t + t, x, gap(t), speed - gap_slope(t), s.moving)
        if t == t_catch:
            self.in_contact = True
            state = replace(state, z=self.zero)
            return seg, state, self.touch(state)
        if t == left:
            return seg, replace(state, moving=False), "free"
        return seg, replace(state, u=self.zero), "waiting" if s.moving else "rest"

    def waiting(self, s: State):
        t_catch, left = -s.z / self.v, self.left(s)
        t = min(t_catch, left)
        seg = Segment("waiting", s.t, t, lambda t: self.zero, lambda t: s.x, self.zero, "start")
        if t_catch < left:
            self.in_contact = True
            state = State(s.t + t, s.x, self.zero, self.zero, True)
            return seg, state, self.touch(state)
        return seg, State(s.t + t, s.x, s.z + self.v * t, self.zero, False), "rest"

    def rest(self, s: State):
        force = self.k * s.z if self.in_contact else self.zero
        seg = Segment("rest", s.t, math.inf, lambda t: force, lambda t: s.x, force, "start")
        return seg, s, None


def _first(pair):
    return pair[0]


def _decay1(fn, rate, t):
    """(1 - exp(-rate t)) / rate."""
    return -fn.expm1(-rate * t) / rate if rate else t


def _decay2(fn, rate, t):
    """(t - _decay1) / rate, by its power series where the difference would cancel."""
    if abs(rate * t) > 0.5:
        return (t - _decay1(fn, rate, t)) / rate
    total, term, n = 0 * t, t * t / 2, 2
    while total + term != total:
        total += term
        n += 1
        term *= -rate * t / n
    return total


def push(
    m, mu_s, ratio, k_v, k, b, v, stroke=None, *, arithmetic=EXACT, horizon=0.0, max_segments=20000
) -> Result:
    """Simulate one push. With no stroke and no release, the segments reach at least to horizon."""
    p = _Push(arithmetic, m, mu_s, ratio, k_v, k, b, v, stroke, horizon)
    state = State(p.zero, p.zero, p.zero, p.zero, True)
    stuck_first = not p.b * p.v > p.static
    segments: list[Segment] = []
    states: list[State] = []
    try:
        mode = p.touch(state)
        while mode is not None:
            before = state
            segment, state, mode = getattr(p, mode)(before)
            segments.append(segment)
            states.append(before)
            if len(segments) > max_segments:
                raise ArithmeticError("too many segments")
    except TooManyContacts:
        return Result(
            None, None, None, stuck_first, p.contacts, tuple(segments), True, tuple(states)
        )

    moved = any(s.mode == "closing" for s in segments)
    if p.in_contact:
        distance = None
        regime = "pushed_to_rest" if moved else "no_motion"
    else:
        distance = state.x - p.lost_at
        regime = "released_by_rebound" if p.lost_moving else "released_at_stop"
    peak = max(s.peak for s in segments)
    return Result(
        peak, distance, regime, stuck_first, p.contacts, tuple(segments), False, tuple(states)
    )


def _both_sides(rig: dict, argument: str, step: str):
    """The results on either side of the rig, and the absolute step."""
    value = MP.mpf(rig[argument])
    h = MP.mpf(step) * (value or 1)
    sides = [push(**{**rig, argument: value + s * h}) for s in (-1, 1)]
    if sides[0].signature[:-1] != sides[1].signature[:-1]:  # peak_at changes no first derivative
        raise ArithmeticError(f"the modes differ on the two sides of {argument}")
    return *sides, h


def derivatives(rig: dict) -> dict[str, dict[str, Number] | None]:
    """d/dp of F_p and d, by central differences with a step of 1e-15 in 60 digits."""
    force, distance = {}, {}
    for name, argument in PARAMETERS.items():
        below, above, h = _both_sides(rig, argument, "1e-15")
        force[name] = (above.peak_force - below.peak_force) / (2 * h)
        if above.sliding_distance is not None:
            distance[name] = (above.sliding_distance - below.sliding_distance) / (2 * h)
    return {"peak_force_N": force, "sliding_distance_m": distance or None}


def second_derivatives(rig: dict) -> dict[str, Number | None]:
    """d2/dmu_s2 of F_p and d."""
    below, above, h = _both_sides(rig, "mu_s", "1e-13")
    middle = push(**rig)
    curve = lambda f: (f(above) - 2 * f(middle) + f(below)) / h**2  # noqa: E731
    there = middle.sliding_distance is not None
    return {
        "peak_force_N": curve(lambda r: r.peak_force),
        "sliding_distance_m": curve(lambda r: r.sliding_distance) if there else None,
    }


def nearest_change(rig: dict, what: str, start: float = 1e-8, stop: float = 1.0):
    """Smallest relative change of mu_s, signed and below stop, that changes `what`; else None.

    Scans outward from `start` in steps of five per cent, then bisects; in floats.
    """

    def changes(delta):
        other = push(**{**rig, "mu_s": rig["mu_s"] * (1 + delta)}, arithmetic=FLOAT)
        return getattr(other, what) != base

    base = getattr(push(**rig, arithmetic=FLOAT), what)
    inner, outer = 0.0, start
    while outer < stop:
        found = [side for side in (-1, 1) if changes(side * outer)]
        if found:
            edges = [s * _bisect(lambda d, s=s: changes(s * d), inner, outer) for s in found]
            return min(edges, key=abs)
        inner, outer = outer, outer * 1.05
    return None


def margin(rig: dict, start: float = 1e-8) -> float | None:
    """Size of the smallest relative change of mu_s that changes regime, stuck_first, contacts."""
    edge = nearest_change(rig, "outcome", start)
    return None if edge is None else abs(edge)


def _bisect(changed, lo, hi):
    while hi - lo > 1e-6 * hi:
        middle = (lo + hi) / 2
        lo, hi = (lo, middle) if changed(middle) else (middle, hi)
    return hi
