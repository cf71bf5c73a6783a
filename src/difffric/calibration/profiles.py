"""Profile-likelihood intervals: error bars that need not be symmetric, nor end.

A parameter is held on a value and everything else is fitted anew: the other shared parameters,
each push's mu_s, its start offset. The interval ends where the penalised chi-square has risen by
the square of the t-quantile. The variances stay at their estimates; what their errors add is in
the degrees of freedom of t. Where the model is linear this is the Gaussian interval.
Source: W. Q. Meeker and L. A. Escobar, The American Statistician 49 (1995) 48-53.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.calibration.result import LEVELS, Fit
from difffric.errors import InputError, NumericalError
from difffric.estimation.coordinates import NOTHING, has_vanished, linear_step, to_value
from difffric.estimation.mixed_fit import (
    ARRIVED,
    Settled,
    descend,
    linearise_at,
    rescan_push_friction,
    take_end,
)
from difffric.estimation.stacked_data import RECORDINGS
from difffric.progress import Tell, silent

FARTHEST = 7.0
"""How far a side is followed [coordinate: a factor e^7; 70 N s/m of k_v, or some of its error
bars] before it is open."""
_CLOSE = 3e-3
"""A bound is found where the root of the rise is this close to its quantile, relatively."""
_NARROW = 1e-6
"""A bracket this narrow [coordinate] holds a jump."""
_MOST = 24
"""Evaluations for one bound."""
_RESCUES = 6
"""How often a parameter's path looks for each push's mu_s elsewhere: that takes long."""
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
        out[label] = _Path(fit, label).profile(sorted(levels))
    tell("done", 1.0)
    return out


class _Path:
    """The constrained optima along one parameter, as far as they were asked for."""

    def __init__(self, fit: Fit, label: str):
        self.fit, self.label = fit, label
        self.model, self.data, at = fit.state.model, fit.state.data, fit.state.at
        self.j = fit.index(label)
        self.trust = 1e3 if self.data.kind == RECORDINGS else 30.0
        self.start = float(at.theta[self.j])
        self.rescues = _RESCUES
        layout = self.model.layout
        self.lower, self.upper = float(layout.lower[self.j]), float(layout.upper[self.j])
        # A damping that runs to zero is held there: chi-square does not depend on it any more.
        self.gone = at.held & (at.theta <= NOTHING)
        self.gone[self.j] = False
        self.slopes = _slopes(fit, at, self.j)
        self.found: dict[float, tuple[float, Settled]] = {}
        base = self._descend(at, at.held)
        if not np.isfinite(self._chi2(base)):
            raise NumericalError("profile: the misfit is not finite at the fit itself")
        self.base = self._chi2(base)
        self.found[self.start] = (self.base, base)

    def profile(self, levels: Sequence[float]) -> Profile:
        intervals: dict[float, list[float | None]] = {level: [None, None] for level in levels}
        reasons: list[str | None] = [None, None]
        for side in (0, 1):
            for level in levels:
                t = float(scipy.stats.t.ppf(0.5 + level / 2, self.fit.freedom[self.j]))
                x, why = self._bound(2 * side - 1, t)
                if x is None:
                    reasons[side] = why
                    break
                intervals[level][side] = self._value(x)
        fall, note = self.base - self.found[self.here][0], None
        if fall > _BETTER:
            note = (
                f"chi-square falls by {fall:.3g} along it, to {self._value(self.here):.6g}: the "
                "fit is not at its optimum; the intervals are about the lowest point found"
            )
        points = sorted((self._value(x), self._rise(x)) for x in self.found)
        return Profile(
            label=self.label,
            value=self.fit.value(self.label),
            intervals={level: (low, high) for level, (low, high) in intervals.items()},
            gaussian={level: self.fit.interval(self.label, level) for level in levels},
            reasons=(reasons[0], reasons[1]),
            curve=np.array(points),
            note=note,
        )

    @property
    def here(self) -> float:
        """The lowest point known: the fit, unless it is not at its optimum."""
        return min(self.found, key=lambda x: (self.found[x][0], x != self.start))

    def _rise(self, x: float) -> float:
        return self.found[x][0] - self.found[self.here][0]

    def _value(self, x: float) -> float:
        if has_vanished(self.label, x):
            return 0.0
        return float(to_value(self.fit.names[self.j], x))

    def _bound(self, sign: int, t: float) -> tuple[float | None, str | None]:
        """Where the root of the rise is t on one side, or why nowhere."""
        error = float(np.sqrt(self.fit.covariance[self.j, self.j]))
        step = t * (error if 0 < error < FARTHEST else 0.1)
        far = max(FARTHEST, 6 * step) if linear_step(self.fit.names[self.j]) else FARTHEST
        end = self.upper if sign > 0 else self.lower
        last = self.start + sign * far
        if sign * (end - last) <= 0:
            last = end
        width = np.inf
        for _ in range(_MOST):
            inner, outer = self._bracket(sign, t)
            if outer is None:
                if sign * (last - inner) <= 0:
                    return None, self._why_open(inner, last == end)
                x = self._outwards(sign, t, inner, step)
                self._evaluate(last if sign * (last - x) <= 1e-9 else x)
                step *= 2
                continue
            r_inner, r_outer = self._root(inner), self._root(outer)
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
            self._evaluate(inner + min(max(share, 0.03), 0.97) * (outer - inner))
        inner, outer = self._bracket(sign, t)
        if outer is None:
            return None, self._why_open(inner, False)
        if not np.isfinite(self._root(outer)):
            return None, f"the model cannot be followed beyond {self._value(inner):.4g}"
        return outer, None

    def _outwards(self, sign: int, t: float, inner: float, step: float) -> float:
        """The next point out, by the last secant of the root of the rise where there is one."""
        known = [x for x in self.found if sign * (x - self.here) >= 0 and sign * (inner - x) >= 0]
        known.sort(key=lambda x: sign * x)
        if len(known) < 2:
            return inner + sign * step
        a, b = known[-2:]
        slope = (self._root(b) - self._root(a)) / abs(b - a)
        ahead = 1.02 * (t - self._root(b)) / slope if slope > 0 else step
        return inner + sign * min(max(ahead, 0.1 * step), 2 * step)

    def _bracket(self, sign: int, t: float) -> tuple[float, float | None]:
        """The farthest point before the rise is reached, and the next one."""
        inner = self.here
        for x in sorted(
            (x for x in self.found if sign * (x - self.here) > 0), key=lambda x: sign * x
        ):
            if self._root(x) >= t:
                return inner, x
            inner = x
        return inner, None

    def _root(self, x: float) -> float:
        return float(np.sqrt(max(self._rise(x), 0.0)))

    def _why_open(self, x: float, at_bound: bool) -> str:
        rise = self._rise(x)
        where = (
            f"at its bound {self._value(x):.4g}" if at_bound else f"as far as {self._value(x):.3g}"
        )
        if x == self.here:
            return f"the best fit is {where}"
        return f"{where} chi-square has risen by {rise:.3g} only"

    def _evaluate(self, x: float) -> None:
        """Hold the parameter on x and fit everything else, from the nearest point known."""
        near = min(self.found, key=lambda known: abs(known - x))
        _, at = self.found[near]
        theta = at.theta + np.where(at.held, 0.0, self.slopes[0]) * (x - near)
        theta[self.j] = x
        ahead = replace(at, theta=theta, s_eta=at.s_eta + self.slopes[1] * (x - near))
        expected = self._expected(x)
        best = self._inside(ahead)
        more = not self._chi2(best) - self.base < 1.5 * expected + 0.5
        if more and expected > 0 and self.rescues:
            self.rescues -= 1
            # More than expected: perhaps one push stays on the wrong side of a jump.
            plain = at.theta.copy()
            plain[self.j] = x
            best = min(best, self._inside(replace(at, theta=plain)), key=self._key)
            other = rescan_push_friction(self.model, self.data, best)
            if other is not best:
                best = min(best, self._inside(other), key=self._key)
        self.found[x] = (self._key(best), best)

    def _expected(self, x: float) -> float:
        variance = self.fit.covariance[self.j, self.j]
        return (x - self.start) ** 2 / variance if variance > 0 else 0.0

    def _inside(self, at: Settled) -> Settled:
        """The constrained optimum, the other parameters within their bounds."""
        layout = self.model.layout
        held = self.gone | at.held
        held[self.j] = True
        for _ in range(4):
            beyond = ((at.theta < layout.lower) | (at.theta > layout.upper)) & ~held
            held = held | beyond
            theta = np.where(beyond, np.clip(at.theta, layout.lower, layout.upper), at.theta)
            at = self._descend(replace(at, theta=theta), held)
            if ((at.theta < layout.lower) | (at.theta > layout.upper))[~held].any():
                continue
            released = self._pulled_inside(at, held)
            if not released.any():
                break
            held = held & ~released
        return at

    def _pulled_inside(self, at: Settled, held: NDArray) -> NDArray:
        """Which parameters held at a bound chi-square would take back inside."""
        layout = self.model.layout
        rows = np.asarray(at.end.rows)[: self.data.n] * at.weights[..., None]
        pull = -np.einsum("nmp,nm->p", rows[..., :-1] @ layout.selection, rows[..., -1])
        inward = np.where(at.theta <= layout.lower, pull > ARRIVED, pull < -ARRIVED)
        inward &= held & ~self.gone & (layout.lower < layout.upper)
        inward[self.j] = False
        return inward

    def _descend(self, at: Settled, held: NDArray) -> Settled:
        scatter = at.scatter
        end: Any = descend(self.model, self.data, at, held, at.weights, scatter, self.trust)
        return take_end(at, end, held, scatter)

    def _key(self, at: Settled) -> float:
        chi2 = self._chi2(at)
        return chi2 if np.isfinite(chi2) else np.inf

    def _chi2(self, at: Settled) -> float:
        """The penalised sum of squares; what was known of held parameters counts too."""
        layout = self.model.layout
        held = np.where(at.held, 1.0 / layout.prior_sd, 0.0)
        return float(at.end.chi2) + float(((held * (at.theta - layout.start)) ** 2).sum())


def _slopes(fit: Fit, at: Settled, j: int) -> tuple[NDArray, NDArray]:
    """How the others go along with parameter j where the model is linear: d theta (free,) and
    d s_eta (n,) for a unit of its coordinate."""
    model, data = fit.state.model, fit.state.data
    along = np.zeros(len(at.theta))
    if fit.covariance[j, j] > 0:
        along = fit.covariance[:, j] / fit.covariance[j, j]
    along = np.where(np.abs(along) < FARTHEST, along, 0.0)
    along[j] = 1.0
    linear, P = linearise_at(model, data, at), len(at.theta)
    G = linear.known + np.einsum("gnij,g->nij", linear.groups, 1.0 / at.spreads**2)
    z = G[:, P + 1]
    own = at.scatter**2 / (1.0 + at.scatter**2 * z[:, P + 1])
    return along, -own * (z[:, :P] @ along)
