"""Whether something outside the catalogue explains the data better than any set of causes.

A smooth curve corrects one component at a time; its coefficients are normal about zero, correlated
along the curve (a Gaussian process), with a length and a size that are averaged over. It competes
with the sets of causes by the same likelihood, beside the same background.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.cause_sets import weigh_set
from difffric.diagnosis.background.evidence import (
    BackgroundState,
    Evidence,
    PossibleCause,
    sum_logs,
)
from difffric.diagnosis.background.joint_fit import measure_left
from difffric.diagnosis.background.naming import BACKGROUND
from difffric.diagnosis.background.search import BackgroundSearch
from difffric.diagnosis.background.small_effects import ask_at
from difffric.diagnosis.conclusion import TOO_MANY
from difffric.diagnosis.data import DiagnosisData
from difffric.diagnosis.inferred.changes import compare_readings
from difffric.diagnosis.location import add_free_forms
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig import free_form
from difffric.rig.free_form import FORMS

_LENGTHS = (0.7, 1.5, 3.5)
"""Lengths over which a curve bends, in its splines."""
_SIZES = np.geomspace(1e-4, 0.5, 9)
"""Relative sizes of a curve."""
_SELDOM = float(np.log(3.0))
"""Log odds against something outside the catalogue."""
_ODDS = float(np.log(20.0))
"""Log odds by which a curve must explain the data better than causes, or nothing, do."""
_STEP = 1e-5
"""Coefficient by which the columns of curves are measured: at 2e-3 some were half of what they are
by derivatives, good sensors see so much; at 1e-5 they are within some hundredths."""
_LITTLE = 0.25
"""Share of what causes explain by themselves that they add to a curve where it stands for them."""
_FAR_OFF = 10.0
"""Squares per number from which on a fit explains nothing: no rig whose cause was named rightly was
left with more than 3."""
_MANY, _HALF = 3, 0.5
"""From how many causes on one may doubt that they are any, and the share of what they explain."""


@dataclass(frozen=True)
class CurveComparison:
    """Log posterior probabilities, but for a constant: those of nothing at all are 0."""

    causes: float
    """of the causes alone"""
    curves: dict[str, float]
    """of each free form alone"""
    both: dict[str, float]
    """of each beside the causes"""
    count: int = 0
    """how many causes there are"""
    change: float = 0.0
    """share of mu_s that changes F_p or d by as much as the best curve does"""
    share: float = 0.0
    """of their units by which all effects that are no causes scatter"""
    left: float = 1.0
    """squares per number, in units of the noise, that the joint fit leaves"""

    @property
    def best(self) -> str:
        """The form that explains most by itself."""
        return max(self.curves, key=lambda name: self.curves[name])

    @property
    def leading(self) -> tuple[str, ...]:
        """The form that explains most by itself, and the next where that may imitate another."""
        ranked = sorted(self.curves, key=lambda name: -self.curves[name])
        return tuple(ranked[: 2 if FORMS[ranked[0]].least else 1])

    @property
    def may_be_needed(self) -> bool:
        """Whether a curve, alone or beside the causes, explains more than they do by such odds."""
        most = max((*self.curves.values(), *self.both.values()))
        return most > max(self.causes, 0.0) + _ODDS

    def rank_forms(self) -> list[str]:
        """List the forms, that one first which explains most by itself or beside the causes."""
        return sorted(self.curves, key=lambda x: -max(self.curves[x], self.both.get(x, -np.inf)))

    @property
    def is_outside(self) -> bool:
        """Whether a curve explains the data better than the causes, which add little to it, and
        than nothing at all, by odds that leave no doubt: a smooth cause is a smooth curve, too.

        Of many causes it is enough that a curve explains half of what they do, and is needed beside
        them: they then imitate what none of them is. So do as many causes that stand out while all
        other effects are exactly at their nulls, which no rig's are. Beside a background a curve is
        needed where a small shape is at a wrong place, too: there they must add little to it. Where
        ten times the noise is left, whatever causes add to a curve explains nothing.
        """
        if self.count >= TOO_MANY and self.share <= BACKGROUND:
            return True
        alone, beside = self.curves[self.best], max(self.both.values(), default=0.0)
        causes, added = max(self.causes, 0.0), max(beside - alone, 0.0)
        imitated = self.count >= _MANY and alone > _HALF * self.causes
        if self.share > BACKGROUND:
            imitated &= added <= _HALF * causes
        if imitated and beside > self.causes + _ODDS:
            return True
        return alone > causes + _ODDS and (added <= _LITTLE * causes or self.left > _FAR_OFF)


def compare_with_curves(
    data: DiagnosisData,
    search: BackgroundSearch,
    items: Sequence[PossibleCause],
    plain: Fits,
    base: Fits,
) -> CurveComparison:
    """Compare the causes `items` with curves in place of them and beside them; `plain` and `base`
    are the fits without and with them, and without a background (ensembles of one)."""
    task, joint, evidence = data.task, search.joint, search.evidence
    wide = add_free_forms(task, data.scales)
    K = len(task.model.coordinates.names)
    c = np.zeros((task.n, len(wide.model.coordinates.names)))
    c[:, :K] = joint.c[0]
    c[:, 0] = joint.mu[0, task.condition] + joint.own[0]
    curves = np.split(_measure_columns(wide, joint), len(FORMS), axis=2)
    priors = np.array([size**2 * _correlate(length) for length in _LENGTHS for size in _SIZES])
    price = float(np.log(len(FORMS))) + _SELDOM
    alone = list(_weigh_curves(evidence, (), curves, priors))
    beside = list(_weigh_curves(evidence, items, curves, priors)) if items else []
    linear, share = weigh_set(evidence, items).score, evidence.estimate_share(items)
    causes = linear
    if share <= BACKGROUND:
        # To take a shape out again is anything but linear: no set explains more than was seen.
        value = ensemble.criterion(task, ensemble.join(plain, base))
        causes = min(causes, 0.5 * float(value[0] - value[1]))
    without = sum_logs([x for _, x in evidence.list_states(items)]) - evidence.nothing
    best = int(np.argmax([x.gain for x in alone]))
    bent = c.copy()
    bent[:, K + best * free_form.SPLINES :][:, : free_form.SPLINES] = alone[best].coefficients
    explained = {form: x.gain - price for form, x in zip(FORMS, alone, strict=True)}
    both = {
        form: causes + x.gain - float(without) - price
        for form, x in zip(FORMS, beside, strict=False)
    }
    if causes < linear:
        explained = limit_curves(explained, both)
    return CurveComparison(
        causes=causes,
        count=len(items),
        curves=explained,
        both=both,
        change=compare_readings(wide, bent, c).as_mu_s,
        share=share,
        left=measure_left(task, joint),
    )


def limit_curves(alone: dict[str, float], both: dict[str, float]) -> dict[str, float]:
    """Return what each curve explains alone, no more than it does beside the causes: where a large
    shape was taken out again, linear answers promise more than there is to explain."""
    return {form: min(x, both[form]) for form, x in alone.items()}


def _measure_columns(wide: EnsembleTask, joint: Fits) -> NDArray:
    """The columns (n, R, k) of the residuals' changes by each coefficient of the free forms, where
    the joint fit stands.

    By differences, as those of shapes: a program of all forms with derivatives is compiled for a
    minute, and those are asked for once. Of a step forwards and one backwards that counts for a
    push which moves it less: one on an edge jumps by the other.
    """
    K, names = joint.c.shape[1], wide.model.coordinates.names
    at = np.concatenate([joint.c[0], np.zeros(len(names) - K)])
    count = len(names) - K
    points = np.tile(at, (1 + 2 * count, 1))
    points[1:, K:] = _STEP * np.concatenate([np.eye(count), -np.eye(count)])
    r, _ = ask_at(wide, joint, points)
    up, down = ((r[1:] - r[0]) / _STEP).reshape(2, count, wide.n, -1)
    size_up, size_down = (np.einsum("knr,knr->kn", x, x) for x in (up, down))
    moved = np.where((size_up <= size_down)[..., None], up, -down)
    # A push that cannot be followed beside the fit says nothing.
    moved = np.where(np.isfinite(moved).all(axis=2, keepdims=True), moved, 0.0)
    return np.moveaxis(moved, 0, 2)


class _WeighedCurve(NamedTuple):
    gain: float
    """log likelihood beyond that of nothing at all, averaged over states and priors"""
    coefficients: NDArray
    """(k,) the best in the most probable state, by the most probable prior"""


def _weigh_curves(
    evidence: Evidence,
    items: Sequence[PossibleCause],
    curves: Sequence[NDArray],
    priors: NDArray,
) -> Iterator[_WeighedCurve]:
    """Yield what each of the `curves` explains beside the `items` as causes: k columns (n, R, k),
    whose sizes are normal about zero with one of the covariances `priors` (m, k, k)."""
    states = evidence.list_states(items)
    for rows in curves:
        cross = np.swapaxes(evidence.rows, 1, 2) @ rows
        gram, own = np.swapaxes(rows, 1, 2) @ rows, np.einsum("nr,nrk->nk", evidence.push, rows)
        logs, fits = [], []
        for state, log in states:
            gains, coefficients = _fit_curve(evidence, state, cross, gram, own, priors)
            logs += list(log + 0.5 * gains)
            fits += list(coefficients)
        gain = float(sum_logs(logs) - np.log(len(priors)) - evidence.nothing)
        yield _WeighedCurve(gain, fits[int(np.argmax(logs))])


def _fit_curve(
    evidence: Evidence,
    state: BackgroundState,
    cross: NDArray,
    gram: NDArray,
    own: NDArray,
    priors: NDArray,
) -> tuple[NDArray, NDArray]:
    """Return, for each of the `priors` (m, k, k), by how much -2 log likelihood falls with the
    columns of a curve (m,) and their best coefficients (m, k); `cross` (n, p, k), `gram` (n, k, k)
    and `own` (n, k) are their products with those of the evidence, with each other and with the
    pushes' own mu_s."""
    P, excess = evidence.known, evidence.excess
    weight = state.scatter**2 / (excess + state.scatter**2 * evidence.z)
    X = cross.sum(axis=0) - np.einsum("n,np,nk->pk", weight, evidence.own, own)
    Y = gram.sum(axis=0) - np.einsum("n,nj,nk->jk", weight, own, own)
    X, Y = X / excess, Y / excess
    mixed = X[P:] - state.known.T @ X[:P]
    Y = Y - X[:P].T @ state.inverse @ X[:P]
    mixed, q = mixed[:-1], mixed[-1]
    if state.C is not None and state.B is not None:
        spread = state.B[:, None] * state.C * state.B
        Y = Y - mixed.T @ spread @ mixed
        q = q - mixed.T @ spread @ state.h
    S = np.eye(len(q)) + Y @ priors
    best = (priors @ np.linalg.solve(S, np.tile(q[:, None], (len(priors), 1, 1))))[:, :, 0]
    return best @ q - np.linalg.slogdet(S)[1], -best


def _correlate(length: float) -> NDArray:
    """The correlation of a curve's coefficients."""
    k = np.arange(free_form.SPLINES)
    return np.exp(-0.5 * ((k[:, None] - k) / length) ** 2) + 1e-8 * np.eye(len(k))
