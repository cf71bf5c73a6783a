"""Profile-likelihood intervals: error bars that need not be symmetric, nor end.

A parameter is held on a value and everything else is fitted anew: the other shared parameters,
each push's mu_s, its start offset. The interval ends where the penalised chi-square has risen by
the square of the t-quantile. The variances stay at their estimates; what their errors add is in
the degrees of freedom of t. Where the model is linear this is the Gaussian interval.
Source: W. Q. Meeker and L. A. Escobar, The American Statistician 49 (1995) 48-53.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.calibration.held_parameter import HeldParameter
from difffric.calibration.result import LEVELS, Fit
from difffric.errors import InputError
from difffric.estimation.coordinates import linear_step
from difffric.progress import Tell, silent

FARTHEST = 7.0
"""How far a side is followed [coordinate: a factor e^7; 70 N s/m of k_v, or some of its error
bars] before it is open."""
_CLOSE = 3e-3
"""A bound is found where the root of the rise is this close to its quantile, relatively."""
_NARROW = 1e-6
"""A bracket this narrow [coordinate] holds a jump."""
_MOST = 24
"""Fits with the parameter held for one bound."""
_FIRST_STEP = 0.1
"""The first step out, for one standard deviation, where the standard error says nothing."""
_BEYOND = 1.02
"""A secant aims this much beyond the bound, so that the next point brackets it."""
_MARGIN = 0.03
"""A secant inside a bracket keeps this share of it away from either end."""
_SAME = 1e-9
"""Coordinates this close are one."""
_BETTER = 0.05
"""A fall of chi-square by more than this says that the fit was not at its optimum."""


@dataclass(frozen=True)
class Profile:
    """How chi-square rises with one parameter, and the intervals that follow [SI]."""

    label: str
    value: float
    intervals: dict[float, tuple[float | None, float | None]]
    """level -> (lower, upper); None: open, and `reasons` says why"""
    gaussian: dict[float, tuple[float, float] | None]
    """the same from the standard error; None at a bound"""
    reasons: tuple[str | None, str | None]
    """why the lower or the upper side is open at some level"""
    curve: NDArray
    """(points, 2): value, rise of chi-square; ascending"""
    note: str | None = None

    @property
    def asymmetry(self) -> float | None:
        """Upper arm over lower arm of the 95 % interval (or the widest closed one); None: open."""
        for level in sorted(self.intervals, key=lambda x: abs(x - 0.95)):
            low, high = self.intervals[level]
            if low is not None and high is not None and low < self.value < high:
                return (high - self.value) / (self.value - low)
        return None

    def as_dict(self) -> dict:
        """As `result.json` holds it."""
        return {
            "value": self.value,
            "intervals": {f"{level:g}": list(x) for level, x in self.intervals.items()},
            "asymmetry": self.asymmetry,
            "reason_lower": self.reasons[0],
            "reason_upper": self.reasons[1],
            "curve": self.curve.tolist(),
            "note": self.note,
        }

    def __str__(self) -> str:
        lines = [f"{self.label} = {self.value:.6g}"]
        for level, ends in self.intervals.items():
            low, high = ("open" if x is None else f"{x:.6g}" for x in ends)
            lines.append(f"    {100 * level:.4g} %: {low} .. {high}")
        if self.asymmetry is not None:
            lines.append(f"    upper arm / lower arm = {self.asymmetry:.3g}")
        sides = zip(("lower", "upper"), self.reasons, strict=True)
        lines += [f"    {side} side open: {why}" for side, why in sides if why]
        return "\n".join(lines + ([f"    note: {self.note}"] if self.note else []))


def profile(
    fit: Fit,
    labels: Sequence[str] | None = None,
    levels: Sequence[float] = LEVELS,
    tell: Tell = silent,
) -> dict[str, Profile]:
    """Profile-likelihood intervals of some free parameters (default: all), by label.

    A side is open (None) where chi-square does not rise enough before the parameter's bound, or
    `FARTHEST` from the estimate. A parameter at its bound has a one-sided profile.
    `tell(what, share done)` hears of the progress.

    Raises `InputError` for an unknown label and for a level outside (0, 1); `NumericalError`
    where the misfit at the fit itself is not finite.
    """
    chosen = fit.free if labels is None else tuple(labels)
    unknown = [x for x in chosen if x not in fit.free]
    if unknown:
        raise InputError(
            f"profile: not free in this fit: {', '.join(unknown)}; "
            f"expected some of {', '.join(fit.free)}"
        )
    wrong = [x for x in levels if not 0 < x < 1]
    if wrong or not len(levels):
        raise InputError(f"profile: levels are {list(levels)}: expected numbers between 0 and 1")
    out = {}
    for i, label in enumerate(chosen):
        tell(f"profile of {label}", i / len(chosen))
        out[label] = _profile_one(fit, label, sorted(levels))
    tell("done", 1.0)
    return out


def _profile_one(fit: Fit, label: str, levels: Sequence[float]) -> Profile:
    """The profile of one parameter, for ascending levels."""
    held = HeldParameter(fit, label)
    intervals: dict[float, list[float | None]] = {level: [None, None] for level in levels}
    reasons: list[str | None] = [None, None]
    for side in (0, 1):
        for level in levels:
            t = float(scipy.stats.t.ppf(0.5 + level / 2, fit.freedom[held.j]))
            x, why = _find_bound(held, 2 * side - 1, t)
            if x is None:
                reasons[side] = why
                break
            intervals[level][side] = held.value(x)
    note = None
    if held.fall > _BETTER:
        note = (
            f"chi-square falls by {held.fall:.3g} along it, to {held.value(held.lowest):.6g}: the "
            "fit is not at its optimum; the intervals are about the lowest point found"
        )
    return Profile(
        label=label,
        value=fit.value(label),
        intervals={level: (low, high) for level, (low, high) in intervals.items()},
        gaussian={level: fit.interval(label, level) for level in levels},
        reasons=(reasons[0], reasons[1]),
        curve=np.array(sorted((held.value(x), held.rise(x)) for x in held.found)),
        note=note,
    )


def _find_bound(held: HeldParameter, sign: int, t: float) -> tuple[float | None, str | None]:
    """Where the root of the rise is t on one side (`sign` -1: below), or why nowhere.

    Written by hand, as chi-square may jump, fail, or fall below the fit's on the way, which moves
    the root that is looked for. `scipy.optimize.toms748` takes a fifth fewer fits where it is
    smooth, but up to a quarter more where it jumps, and then ends elsewhere.
    """
    step, last, at_bound = _plan_way(held, sign, t)
    width = np.inf
    for _ in range(_MOST):
        inner, outer = _bracket(held, sign, t)
        if outer is None:
            if sign * (last - inner) <= 0:
                return None, _say_why_open(held, inner, at_bound)
            x = _go_outwards(held, sign, t, inner, step)
            held.hold(last if sign * (last - x) <= _SAME else x)
            step *= 2
            continue
        r_inner, r_outer = held.root(inner), held.root(outer)
        if abs(r_outer - t) <= _CLOSE * t:
            return outer, None
        if t - r_inner <= _CLOSE * t:
            return inner, None
        if abs(outer - inner) < _NARROW:
            break
        share = (t - r_inner) / (r_outer - r_inner) if np.isfinite(r_outer) else 0.5
        if abs(outer - inner) > 0.5 * width:
            share = 0.5  # a kink: halve
        width = abs(outer - inner)
        held.hold(inner + min(max(share, _MARGIN), 1 - _MARGIN) * (outer - inner))
    inner, outer = _bracket(held, sign, t)
    if outer is None:
        return None, _say_why_open(held, inner, False)
    if not np.isfinite(held.root(outer)):
        return None, f"the model cannot be followed beyond {held.value(inner):.4g}"
    return outer, None


def _plan_way(held: HeldParameter, sign: int, t: float) -> tuple[float, float, bool]:
    """The first step out, the last coordinate to look at, and whether that is a bound."""
    error = float(np.sqrt(held.variance))
    step = t * (error if 0 < error < FARTHEST else _FIRST_STEP)
    far = max(FARTHEST, 6 * step) if linear_step(held.name) else FARTHEST
    end = held.upper if sign > 0 else held.lower
    last = held.start + sign * far
    if sign * (end - last) <= 0:
        last = end
    return step, last, last == end


def _go_outwards(held: HeldParameter, sign: int, t: float, inner: float, step: float) -> float:
    """The next point out, by the last secant of the root of the rise where there is one."""
    known = [x for x in held.found if sign * (x - held.lowest) >= 0 and sign * (inner - x) >= 0]
    known.sort(key=lambda x: sign * x)
    if len(known) < 2:
        return inner + sign * step
    a, b = known[-2:]
    slope = (held.root(b) - held.root(a)) / abs(b - a)
    ahead = _BEYOND * (t - held.root(b)) / slope if slope > 0 else step
    return inner + sign * min(max(ahead, 0.1 * step), 2 * step)


def _bracket(held: HeldParameter, sign: int, t: float) -> tuple[float, float | None]:
    """The farthest point known before the rise is reached, and the next one, if there is one."""
    inner = held.lowest
    beyond = [x for x in held.found if sign * (x - inner) > 0]
    for x in sorted(beyond, key=lambda x: sign * x):
        if held.root(x) >= t:
            return inner, x
        inner = x
    return inner, None


def _say_why_open(held: HeldParameter, x: float, at_bound: bool) -> str:
    value = held.value(x)
    where = f"at its bound {value:.4g}" if at_bound else f"as far as {value:.3g}"
    if x == held.lowest:
        return f"the best fit is {where}"
    return f"{where} chi-square has risen by {held.rise(x):.3g} only"
