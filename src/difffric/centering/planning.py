"""Planning: the push that brings a part to its target, and how likely it is to land there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from difffric.centering.belief import Belief
from difffric.centering.landing import find_landings, find_strokes
from difffric.errors import InputError
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.rig.setup import Extras, Setup
from difffric.simulation.segments import Integrator
from difffric.units import GRAVITY, from_mm, from_mm_min, from_um, to_mm, to_mm_min, to_um

WITHIN = from_um(2.5)
"""Tolerance of the target [m], unless said: the paper's target alignment."""
SURE = 0.99
"""Probability of being within the tolerance that is enough, unless said."""
SPEEDS = from_mm_min(np.geomspace(500.0, 5000.0, 16))
"""Speeds to choose from [m/s], unless said: the paper's range."""
REACH = from_mm(20.0)
"""[m] that a part can be pushed, unless said."""
SCATTER = 0.015
"""Relative scatter of mu_s from push to push, unless the set-up says."""
HANDLING = 1.0
"""[s] that a push takes beside its own time, unless said."""

_LOWER = np.array([1e-3, 0.005, 0.02, 0.06, 0.13, 0.22, 0.32, 0.42])
_SHARES = np.concatenate([_LOWER, [0.5], 1 - _LOWER[::-1]])
"""Quantiles of the next push's mu_s at which it is followed: close in the tails, where a landing
fails."""
_SHORT = from_um(np.array([0.0, 6.0, 18.0, 60.0]))
"""[m] before the target, where a first push of several may aim."""
_MOST = 4
"""Pushes of a plan: what comes later is known too little now."""
_LEFT = from_um(np.array([2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 700.0, 2000.0]))
"""[m] to go, at which a second push is looked at; between them is interpolated."""


@dataclass(frozen=True)
class Known:
    """What a push is planned with."""

    rig: Rig
    mu_s: Belief
    errors: Mapping[str, float] = field(default_factory=dict)
    """parameter other than mu_s -> its standard error [SI], taken as if independent"""
    speeds: NDArray = field(default_factory=lambda: SPEEDS)
    """speeds to choose from [m/s]"""
    within: float = WITHIN
    """tolerance of the target [m]"""
    reach: float = REACH
    """distance that the rails allow [m]"""
    handling: float = HANDLING
    """what a push takes beside its own time [s]"""
    integrator: Integrator | None = None
    """how pushes are followed; by default as the rig's laws allow"""

    @classmethod
    def of(cls, setup: Setup, mu_s: Belief | None = None, **chosen: Any) -> Known:
        """Return what a set-up says: its standard errors, its mu_s unless that is given, and its
        scatter, `SCATTER` where it has none. `chosen` are other fields."""
        extras, values = setup.extras, parameters.values(setup.rig)
        errors = {
            name: said.standard_error
            for name, said in extras.items()
            if name in values and name != "mu_s" and said.standard_error is not None
        }
        scatter = SCATTER if setup.mu_s_scatter is None else setup.mu_s_scatter
        if mu_s is None:
            mean, said = float(values["mu_s"]), extras.get("mu_s", Extras())
            mu_s = Belief.normal(mean, (said.standard_error or 0.0) / mean, scatter)
        return cls(setup.rig, replace(mu_s, scatter=scatter), errors, **chosen)


@dataclass(frozen=True)
class Options:
    """The push for each speed and target, as arrays (targets, speeds)."""

    velocity: NDArray
    """(speeds,) [m/s]"""
    stroke: NDArray
    """[m]; NaN where none leaves the part at the target"""
    duration: NDArray
    """[s]"""
    landing: NDArray
    """(targets, speeds, shares) displacement less the target [m], at quantiles of mu_s"""
    by_mu_s: NDArray
    """d displacement / d ln mu_s [m]"""
    rest: dict[str, NDArray]
    """source other than mu_s -> standard deviation of the landing by it [m]"""
    probability: NDArray
    """of landing within the tolerance"""
    released: NDArray
    """whether the part leaves the tip, with the median mu_s"""

    def best(self, target: int, sure: float = SURE) -> int:
        """Choose a push to a target: the fastest that lands with the probability `sure`, else the
        likeliest to land. Returns the index of its speed."""
        p = np.nan_to_num(self.probability[target], nan=-1.0)
        time = np.where(p >= sure, self.duration[target], np.inf)
        return int(np.argmin(time)) if np.isfinite(time).any() else int(np.argmax(p))


@dataclass(frozen=True)
class PlannedPush:
    """One push of a plan."""

    velocity: float
    stroke: float
    duration: float
    aim: float
    """[m] from where the part stands to where the push should leave it"""
    probability: float
    """of being within the tolerance of the target after it"""
    deviations: dict[str, float]
    """source -> standard deviation of the landing by it [m]; `all`: by all of them together"""
    released: bool
    """whether the part leaves the tip; else it rests in contact, and there is no d"""

    @property
    def limited_by(self) -> str:
        """The source that spreads the landing most."""
        return max((s for s in self.deviations if s != "all"), key=self.deviations.__getitem__)


@dataclass(frozen=True)
class Plan:
    """The next push, and those that are likely to follow."""

    target: float
    target_error: float
    steps: tuple[PlannedPush, ...]
    """the first is to be made; what follows is what is likely then"""
    probability: float
    """of being within the tolerance after the last of them"""
    options: Options
    """the first push at each speed, towards the target itself"""

    @property
    def next(self) -> PlannedPush:
        """The push to make."""
        return self.steps[0]


def plan(
    known: Known | Setup | Rig, target: float, target_error: float = 0.0, sure: float = SURE
) -> Plan:
    """Plan the push that brings a part `target` metres further.

    A set-up says itself what is `known` (`Known.of`); a rig alone is known exactly. The target is
    known with a standard error [m].

    The plan is the fastest push that lands within the tolerance with at least the probability
    `sure`. Where there is none, it is the first of two or more that do, or the best to be had.

    Raises `InputError` for a target out of reach, and where no push ends there.
    """
    if not isinstance(known, Known):
        known = Known.of(known if isinstance(known, Setup) else Setup(known))
    if not (np.isfinite(target) and target > 0):
        raise InputError(f"the offset: expected a distance > 0, got {to_um(target):g} um")
    if target > known.reach:
        raise InputError(
            f"the offset: {to_mm(target):g} mm is out of reach: the rails allow "
            f"{to_mm(known.reach):g} mm"
        )
    here = find_options(known, np.array([target]), target_error)
    if not np.isfinite(here.stroke).any():
        lo, hi = to_mm_min(known.speeds.min()), to_mm_min(known.speeds.max())
        raise InputError(
            f"the speeds: between {lo:g} and {hi:g} mm/min no push that can be followed ends "
            f"{to_um(target):g} um away; a part that breaks away late jumps further"
        )
    i = here.best(0, sure)
    single = _make_push(here, 0, i, target)
    if single.probability >= sure:
        return Plan(target, target_error, (single,), single.probability, here)
    return _plan_several(known, target, target_error, here, single, sure)


def find_options(known: Known, targets: NDArray, target_error: float) -> Options:
    """Find, for each target [m] and speed, the stroke that ends there and how the landing spreads.

    The stroke is that of the median mu_s, or one beside it that lands within more often.
    """
    rig, V, T, K = known.rig, len(known.speeds), len(targets), len(_SHARES)
    mu = known.mu_s.quantiles(_SHARES)
    median = float(mu[K // 2])
    velocity, target = np.tile(known.speeds, T), np.repeat(targets, V)
    names = ("mu_s", *known.errors)
    longest = target + _find_slack(rig, float(mu[-1]))
    found = find_strokes(
        rig, velocity, target, median, longest, by=names, integrator=known.integrator
    )
    stroke = found.stroke
    rest = {"offset": np.full(T * V, target_error)}
    rest |= {name: np.abs(found.by[name]) * error for name, error in known.errors.items()}
    sigma = np.sqrt(sum(s**2 for s in rest.values()))
    there = np.isfinite(stroke)
    tried = np.where(there, stroke, target)

    def land(stroke: NDArray) -> tuple[NDArray, NDArray]:
        x = find_landings(
            rig, velocity.repeat(K), stroke.repeat(K), np.tile(mu, T * V), known.integrator
        )
        slid = np.isfinite(x.sliding_distance.reshape(T * V, K)[:, K // 2])
        return x.displacement.reshape(T * V, K) - target[:, None], slid

    landing, released = land(tried)
    probability = find_probability(landing, sigma, known.within)
    # The median is not where most of a skew density lies: another aim may land more often.
    width = np.minimum(_measure_spread(landing), 5 * known.within)
    shifts = np.linspace(-1.0, 1.0, 9)[:, None] * width
    p = np.stack([find_probability(landing + s[:, None], sigma, known.within) for s in shifts])
    shift = shifts[np.argmax(np.nan_to_num(p, nan=-1.0), axis=0), np.arange(T * V)]
    if np.any(np.abs(shift) > 0.1 * known.within):
        other = np.maximum(tried + shift / np.maximum(found.by_stroke, 0.1), 0.0)
        other = np.where(there, other, tried)
        elsewhere, _ = land(other)  # not all mu_s move as the median does
        better = find_probability(elsewhere, sigma, known.within) > probability
        stroke = np.where(better, other, stroke)
        landing = np.where(better[:, None], elsewhere, landing)
        probability = find_probability(landing, sigma, known.within)
    probability = np.where(there, probability, np.nan)

    def shape(a: NDArray) -> NDArray:
        return np.where(there, a, np.nan).reshape(T, V)

    return Options(
        velocity=known.speeds,
        stroke=shape(stroke),
        duration=shape(found.duration),
        landing=landing.reshape(T, V, K),
        by_mu_s=shape(found.by["mu_s"] * median),
        rest={name: shape(s) for name, s in rest.items()},
        probability=probability.reshape(T, V),
        released=released.reshape(T, V),
    )


def find_probability(landing: NDArray, sigma: ArrayLike, within: float) -> NDArray:
    """Return the probability (...) of |landing| <= within.

    Landings [m] (..., shares) are those at the quantiles `_SHARES`, linear between them, plus
    normal deviations of standard deviation sigma [m] (...).
    """
    a, b = landing[..., :-1], landing[..., 1:]
    share = np.diff(_SHARES)
    s = np.maximum(np.asarray(sigma, float), 1e-12)[..., None]
    apart = np.abs(b - a)
    narrow = apart < 1e-3 * s

    def below(edge: float) -> NDArray:  # the mean of Phi((edge - x) / s) over x from a to b
        u, v = (edge - a) / s, (edge - b) / s
        mean = (_integrate_normal(u) - _integrate_normal(v)) / np.where(narrow, 1.0, u - v)
        return np.where(narrow, scipy.special.ndtr(0.5 * (u + v)), mean)

    inside = below(within) - below(-within)
    tails = [_SHARES[0], 1 - _SHARES[-1]]
    ends = [
        scipy.special.ndtr((within - x) / s[..., 0]) - scipy.special.ndtr((-within - x) / s[..., 0])
        for x in (landing[..., 0], landing[..., -1])
    ]
    return inside @ share + tails[0] * ends[0] + tails[1] * ends[1]


def _integrate_normal(u: NDArray) -> NDArray:
    """Return the integral of the normal distribution function from -infinity to u."""
    return u * scipy.special.ndtr(u) + np.exp(-0.5 * u * u) / np.sqrt(2 * np.pi)


def _measure_spread(landing: NDArray) -> NDArray:
    """Return half the width of the middle 68 % of landings (..., shares)."""
    lo, hi = np.searchsorted(_SHARES, [0.16, 0.84])
    return 0.5 * np.abs(landing[..., hi] - landing[..., lo])


def _find_slack(rig: Rig, mu_s: float) -> float:
    """Return by how much [m] a stroke may be longer than what the part moves: ten times the
    compression in which friction can hold it, and a millimetre."""
    values = parameters.values(rig)
    held = mu_s * float(values["mass_kg"]) * GRAVITY / float(values["k_N_per_m"])
    return 10 * held + from_mm(1.0)


def _make_push(o: Options, target: int, i: int, aim: float) -> PlannedPush:
    """Make the push to a target (its index) at speed i of some options."""
    mu = float(_measure_spread(o.landing[target, i]))
    parts = {"mu_s": mu} | {name: float(s[target, i]) for name, s in o.rest.items()}
    return PlannedPush(
        velocity=float(o.velocity[i]),
        stroke=float(o.stroke[target, i]),
        duration=float(o.duration[target, i]),
        aim=aim,
        probability=float(o.probability[target, i]),
        deviations=parts | {"all": float(np.sqrt(sum(s**2 for s in parts.values())))},
        released=bool(o.released[target, i]),
    )


def _plan_several(
    known: Known, target: float, error: float, here: Options, single: PlannedPush, sure: float
) -> Plan:
    """Plan several pushes: a first one, at the target or short of it, so that the time until the
    part is there is likely to be least. `here` are the options straight to the target, `single` the
    best of them."""
    few, fewer = (replace(known, speeds=_thin_out(known.speeds, n)) for n in (8, 4))
    # After a push its mu_s is known, and a second one is planned with that.
    left = _LEFT[_LEFT <= max(target, _LEFT[0])]
    second = find_options(replace(fewer, mu_s=known.mu_s.foresee()), left, error)
    sure_of = np.max(np.nan_to_num(second.probability, nan=0.0), axis=1)

    aims = target - _SHORT[_SHORT < 0.9 * target]
    first = find_options(few, aims, error)
    away = first.landing + (aims - target)[:, None, None]
    hits = find_probability(away, np.sqrt(sum(s**2 for s in first.rest.values())), known.within)
    far = np.abs(away)
    then = np.interp(np.log(np.maximum(far, left[0])), np.log(left), sure_of)
    weight = np.gradient(_SHARES) / np.gradient(_SHARES).sum()
    reached_by_two = (
        np.where(far <= known.within, 1.0, then) @ weight
    )  # by the second at the latest
    time = first.duration + known.handling * (
        (1 - hits) + (1 - reached_by_two) / max(sure_of.max(), 0.1)
    )
    a, i = map(
        int, np.unravel_index(np.argmin(np.where(np.isfinite(time), time, np.inf)), time.shape)
    )

    made = replace(_make_push(first, a, i, float(aims[a])), probability=float(hits[a, i]))
    to_go = float(np.median(far[a, i]))
    j = int(np.argmin(np.abs(np.log(left / max(to_go, left[0])))))
    follow = replace(_make_push(second, j, second.best(j, sure), to_go), aim=to_go)
    steps, reached = [made, follow], max(float(reached_by_two[a, i]), made.probability)
    while reached < sure and len(steps) < _MOST:
        reached = 1 - (1 - reached) * (1 - follow.probability)
        steps.append(follow)
    if single.probability >= reached:
        steps, reached = [single], single.probability
    return Plan(target, error, tuple(steps), reached, here)


def _thin_out(speeds: NDArray, n: int) -> NDArray:
    """Choose at most n of the speeds, both ends among them."""
    return speeds[np.unique(np.linspace(0, len(speeds) - 1, n).round().astype(int))]


def space_speeds(lower: float, upper: float, count: int = 16) -> NDArray:
    """Return speeds [m/s] to choose from, in equal ratios.

    Raises `InputError` for an empty range.
    """
    if not 0 < lower <= upper < np.inf:
        raise InputError(
            f"the speeds: expected 0 < lowest <= highest, got {to_mm_min(lower):g} to "
            f"{to_mm_min(upper):g} mm/min"
        )
    return np.geomspace(lower, upper, count if upper > lower else 1)
