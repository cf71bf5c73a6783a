"""Several starts, what becomes of each, and the best: how a fit finds its optimum."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.marginal_likelihood import minus_2_log_likelihood
from difffric.calibration.restarts import starts_elsewhere
from difffric.calibration.result import FitState
from difffric.calibration.table_starts import other_branches, ranked_starts
from difffric.errors import NumericalError
from difffric.estimation.coordinates import Layout
from difffric.estimation.mixed_fit import (
    ARRIVED,
    Model,
    Settled,
    descend,
    first_point,
    moved,
    settle,
    unstuck,
)
from difffric.estimation.stacked_data import TABLE, FitData
from difffric.progress import Tell
from difffric.rig import parameters

Ends = list[tuple[float, Settled, int]]
"""Different ends of a search, the best first: chi-square, point, how many starts lead there."""

REFINED = 3
"""How many different ends of the first search are followed to the end."""
ALIKE = 1e-2
"""Ends whose chi-squares differ by less than this are one."""
_DESCENTS = 9
"""Starts from which a first search descends."""
_FIRST_STEPS = 25
_WORTH = 5.0
"""Ends whose chi-square is this many times the best one's are not followed."""
_BRANCHINGS = 3
_LOOSE_SCATTER = 0.05
_ROUNDS, _ELSEWHERE = 2, 4
"""Rounds of a second search, and the starts of each; 2 where the first one is sure."""
_POOR = 3.0
"""A fit whose chi-square is this many times the number of measurements may be no optimum."""
_FRESH_SCATTER = 0.01
_COOLER = 0.3
_LEAST_COOLED = 2e-3


def make_starts(layout: Layout, several: bool = True) -> list[NDArray]:
    """The set-up's own values, and a grid about its stiffness, damping and friction."""
    own = np.clip(layout.start, layout.lower, layout.upper)
    if not several:
        return [own]
    axes = []
    for name in parameters.FREE:
        factor = parameters.PARAMETERS[name].roughness
        if factor is None:
            continue
        shift = np.array([x == name for x in layout.names], float) * np.log(factor)
        if shift.any():
            axes.append([s * shift for s in (-1, 0, 1)])
    grid = [own + sum(shifts) for shifts in product(*axes)]
    inside = [np.clip(x, layout.lower, layout.upper) for x in grid]
    return [own, *(x for x in inside if not np.array_equal(x, own))]


def first_search(model: Model, data: FitData, box: list[NDArray], tell: Tell) -> Ends:
    """Where the starts lead with some per cent of tolerance."""
    if len(box) > 1 and data.kind == TABLE:
        tell("looking for starts", 0.0)
        box = ranked_starts(model, data, box, _DESCENTS)
    return descents(model, data, box, tell)


def descents(model: Model, data: FitData, starts: list[NDArray], tell: Tell) -> Ends:
    """Where descents from `starts` end. Raises `NumericalError` where none is finite."""
    layout = model.layout
    rough = replace(data, weights=data.rough, group=np.full(data.group.shape, -1))
    scatter = max(model.scatter, _LOOSE_SCATTER) if model.estimate_scatter else model.scatter
    ends: list[tuple[float, Settled]] = []
    for i, theta in enumerate(starts):
        tell(f"start {i + 1} of {len(starts)}", 0.1 + 0.3 * i / len(starts))
        at = first_point(model, data, theta)
        end = descend(model, rough, at, at.held, rough.weights, scatter, 1.0, _FIRST_STEPS)
        if np.isfinite(float(end.chi2)):
            at = moved(at, end, at.held, scatter)
            ends.append(
                (float(end.chi2), replace(at, theta=np.clip(at.theta, layout.lower, layout.upper)))
            )
    if not ends:
        raise NumericalError("fit: no start gives a finite misfit")
    ends.sort(key=lambda x: x[0])
    distinct: Ends = []
    for chi2, at in ends:
        if distinct and chi2 - distinct[-1][0] < ALIKE * (1 + chi2):
            distinct[-1] = (*distinct[-1][:2], distinct[-1][2] + 1)
        else:
            distinct.append((chi2, at, 1))
    return distinct


def fit_from_starts(
    model: Model, data: FitData, box: list[NDArray], tell: Tell
) -> tuple[FitState, tuple[int, int]]:
    """The best of the fits settled from several starts, and how many of how many lead to it.

    Raises `NumericalError` where none is finite.
    """
    distinct = first_search(model, data, box, tell)
    contest = _Contest(model, data)
    worth = _WORTH * (distinct[0][0] + data.samples)
    for i, (chi2, at, count) in enumerate(distinct[:REFINED]):
        if chi2 > worth:
            break
        tell("settling", 0.4 + 0.1 * i)
        contest.enter(replace(at, scatter=max(at.scatter, model.scatter)), count)
    contest.tried = sum(n for *_, n in distinct)  # those that were not worth following, too
    if not contest.fits:
        raise NumericalError("fit: the misfit is not finite wherever the search led")
    if data.kind == TABLE:
        for i in range(_ROUNDS if len(box) > 1 else 0):
            before, sure = contest.best, contest.sure
            if sure and i:
                break
            tell("looking elsewhere", 0.7 + 0.1 * i)
            for theta in starts_elsewhere(model, data, before, box, 2 if sure else _ELSEWHERE):
                contest.enter(_fresh(model, data, theta))
            if contest.best is before:
                break
        tell("cooling", 0.9)
        contest.cool()
    return FitState(model, data, contest.best), (contest.reached, contest.tried)


class _Contest:
    """Fits that settled, by how likely each makes the data, and how many starts led to each."""

    def __init__(self, model: Model, data: FitData):
        self.model, self.data = model, data
        self.fits: list[tuple[float, Settled, int]] = []
        self.tried = 0

    @property
    def best(self) -> Settled:
        return self.fits[0][1]

    @property
    def reached(self) -> int:
        """How many starts led to the best."""
        return sum(n for cost, _, n in self.fits if cost - self.fits[0][0] < ALIKE)

    @property
    def sure(self) -> bool:
        """Whether most starts agree on the best, and it fits."""
        poor = not self.data.groups and self.best.components.chi2 > _POOR * self.data.samples
        return not poor and 2 * self.reached > self.tried

    def enter(self, start: Settled, count: int = 1) -> None:
        """Settle from a start that stands for `count`."""
        self.tried += count
        try:
            self._add(self._settled(start), count)
        except NumericalError:
            return

    def cool(self) -> None:
        """Let the best compete with where a smaller scatter leads: too large a scatter, which
        wrong branches bring about, makes them cheap."""
        model, data, at = self.model, self.data, self.best
        if not model.estimate_scatter or at.scatter < _LEAST_COOLED:
            return
        scatter = _COOLER * at.scatter
        at = replace(at, scatter=scatter)
        for _ in range(2):
            end = descend(model, data, at, at.held, at.weights, scatter, 30.0)
            at = moved(at, end, at.held, scatter)
            at = unstuck(model, data, at, other_branches(model, data, at))
        try:
            cooled = self._settled(at)
        except NumericalError:
            return
        if self._cost(cooled) < self.fits[0][0] - ALIKE:
            # The starts that led to the best would have led here.
            self.fits = [(self._cost(cooled), cooled, self.reached), *self.fits]

    def _settled(self, start: Settled) -> Settled:
        done = settle(self.model, self.data, start)
        if self.data.kind != TABLE:
            return done
        return _on_the_best_branches(self.model, self.data, done)

    def _cost(self, done: Settled) -> float:
        if self.data.kind != TABLE:
            return done.components.criterion
        return minus_2_log_likelihood(self.model, self.data, done)

    def _add(self, done: Settled, count: int) -> None:
        self.fits.append((self._cost(done), done, count))
        self.fits.sort(key=lambda x: x[0])


def _fresh(model: Model, data: FitData, theta: NDArray) -> Settled:
    """A start at these shared parameters with each push's own mu_s on its best branch: they are
    better than the pushes' residuals make them look, and settling would leave them."""
    scatter = _FRESH_SCATTER if model.estimate_scatter else model.scatter
    at = replace(first_point(model, data, theta), scatter=scatter)
    everything = np.ones_like(at.held)
    end = descend(model, data, at, everything, at.weights, scatter, 30.0)
    at = replace(moved(at, end, everything, scatter), held=at.held)
    return unstuck(model, data, at, other_branches(model, data, at))


def _on_the_best_branches(model: Model, data: FitData, done: Settled) -> Settled:
    """The fit once every push's own mu_s is on the branch that fits it best."""
    for _ in range(_BRANCHINGS):
        other = unstuck(model, data, done, other_branches(model, data, done))
        if other is done:
            break
        again = settle(model, data, other)
        if again.components.criterion > done.components.criterion - ARRIVED:
            break
        done = again
    return done
