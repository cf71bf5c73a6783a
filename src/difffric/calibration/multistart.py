"""Several starts, what becomes of each, and the best: how a fit finds its optimum."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.marginal.marginal_likelihood import minus_2_log_likelihood
from difffric.calibration.marginal.polish import polish
from difffric.calibration.mu_s_branches import find_branches, settle_on_best_branches
from difffric.calibration.other_basins import find_other_basins
from difffric.calibration.result import FitState
from difffric.calibration.table_starts import rank_starts
from difffric.errors import NumericalError
from difffric.estimation.coordinates import Layout
from difffric.estimation.descent import Model, Settled, descend, first_point, take_end
from difffric.estimation.mixed_fit import settle
from difffric.estimation.push_friction import rescan_push_friction
from difffric.estimation.stacked_data import TABLE, FitData
from difffric.known_so_far import tell_known
from difffric.number_text import format_values
from difffric.progress import Tell, silent
from difffric.rig import parameters

Ends = list[tuple[float, Settled, int]]
"""Different ends of a search, the best first: chi-square, point, how many starts lead there."""

REFINED = 3
"""How many different ends of the rough search are followed to the end."""
ALIKE = 1e-2
"""Ends whose chi-squares differ by less than this are one: it moves no parameter by a tenth of
its standard error."""
_DESCENTS = 9
"""Starts of a table from which the rough search descends: the best of some hundreds."""
_ROUGH_STEPS = 25
"""Steps of a rough descent: it has to tell valleys apart, not to arrive."""
_ROUGH_SCATTER = 0.05
"""The scatter that a rough descent assumes at least, so that a push beyond a jump gives way."""
_WORTH = 5.0
"""Ends whose chi-square is this many times the best one's are not followed."""
_ROUNDS, _MOST_BASINS, _FEWEST_BASINS = 2, 4, 2
"""Rounds in which a table's fit is looked for in other basins, and how many of them are tried;
the fewer where most starts agree already."""
_POOR = 3.0
"""A fit whose chi-square is this many times the number of measurements may be no optimum."""
_TRUST = 30.0
"""How far a descent from a chosen point trusts its linear model at first: far."""
_NEW_SCATTER = 0.01
"""The scatter with which a fit in another basin starts: small, so that each push's own mu_s does
not hide that the shared parameters fit badly."""
_NEAR, _POLISHED = 6.0, 2
"""Fits whose -2 log-likelihood is this near the best's are polished too, and how many at most: the
optimum of the marginal likelihood may lie some units below where a search settled."""
_COOLER = 0.3
"""By how much the scatter is reduced at once, to see whether a colder fit is the better one."""
_LEAST_COOLED = 2e-3
"""A scatter below this hides nothing."""


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


def search_roughly(model: Model, data: FitData, starts: list[NDArray], tell: Tell) -> Ends:
    """Where the starts lead with some per cent of tolerance; of a table's, the promising ones."""
    if len(starts) == 1 and data.kind == TABLE and not model.rig.affine:
        return [(0.0, first_point(model, data, starts[0]), 1)]  # stepped through: no step in vain
    if len(starts) > 1 and data.kind == TABLE:
        tell("looking for starts", 0.0)
        starts = rank_starts(model, data, starts, _DESCENTS)
    return descend_from(model, data, starts, tell)


def descend_from(model: Model, data: FitData, starts: list[NDArray], tell: Tell) -> Ends:
    """Where rough descents from `starts` end. Raises `NumericalError` where none is finite."""
    layout = model.layout
    rough = replace(data, weights=data.rough, group=np.full(data.group.shape, -1))
    scatter = max(model.scatter, _ROUGH_SCATTER) if model.estimate_scatter else model.scatter
    ends: list[tuple[float, Settled]] = []
    for i, theta in enumerate(starts):
        tell(f"start {i + 1} of {len(starts)}", 0.1 + 0.3 * i / len(starts))
        at = first_point(model, data, theta)
        end = descend(model, rough, at, at.held, rough.weights, scatter, 1.0, _ROUGH_STEPS)
        if np.isfinite(float(end.chi2)):
            at = take_end(at, end, at.held, scatter)
            inside = np.clip(at.theta, layout.lower, layout.upper)
            ends.append((float(end.chi2), replace(at, theta=inside)))
    if not ends:
        raise NumericalError("fit: no start gives a finite misfit")
    return _join_alike(sorted(ends, key=lambda end: end[0]))


def _join_alike(ends: list[tuple[float, Settled]]) -> Ends:
    """The different ones among ends (chi-square, point), which are sorted by chi-square."""
    distinct: Ends = []
    for chi2, at in ends:
        if distinct and chi2 - distinct[-1][0] < ALIKE * (1 + chi2):
            distinct[-1] = (*distinct[-1][:2], distinct[-1][2] + 1)
        else:
            distinct.append((chi2, at, 1))
    return distinct


def tell_best_fit(model: Model, at: Settled, tell: Tell) -> None:
    """Tell where the best fit stands by now, unless it is a part of other work, which hears of
    nothing."""
    if tell is not silent:
        values = format_values(model.layout.value(at.theta))
        tell_known("the fit", f"the best by now, without error bars: {values}")


def fit_from_starts(
    model: Model, data: FitData, starts: list[NDArray], tell: Tell
) -> tuple[FitState, tuple[int, int]]:
    """The best of the fits settled from several starts, and how many of how many lead to it.

    Raises `NumericalError` where none is finite.
    """
    distinct = search_roughly(model, data, starts, tell)
    contest = _Contest(model, data)
    worth = _WORTH * (distinct[0][0] + data.samples)
    for i, (chi2, at, count) in enumerate(distinct[:REFINED]):
        if chi2 > worth:
            break
        tell("settling", 0.4 + 0.1 * i)
        contest.enter(replace(at, scatter=max(at.scatter, model.scatter)), count)
        if contest.fits:
            tell_best_fit(model, contest.best, tell)
    contest.tried = sum(n for *_, n in distinct)  # those that were not worth following, too
    if not contest.fits:
        raise NumericalError("fit: the misfit is not finite wherever the search led")
    if data.kind == TABLE:
        if len(starts) > 1:
            _try_other_basins(contest, starts, tell)
        tell("cooling", 0.9)
        contest.try_smaller_scatter()
    tell("polishing", 0.95)
    return FitState(model, data, contest.polish_best()), (contest.reached, contest.tried)


def _try_other_basins(contest: _Contest, starts: list[NDArray], tell: Tell) -> None:
    """Enter fits from other basins, for as long as that brings a better one and in a second round
    only where the best is not sure."""
    model, data = contest.model, contest.data
    for i in range(_ROUNDS):
        before, sure = contest.best, contest.sure
        if sure and i:
            break
        tell("looking elsewhere", 0.7 + 0.1 * i)
        most = _FEWEST_BASINS if sure else _MOST_BASINS
        for theta in find_other_basins(model, data, before, starts, most):
            contest.enter(_start_on_best_branches(model, data, theta))
        if contest.best is before:
            break


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
        """Settle from a start that stands for `count`; one that leads nowhere counts as tried."""
        self.tried += count
        try:
            done = self._settle(start)
            cost = self._cost(done)
        except NumericalError:
            return
        self.fits.append((cost, done, count))
        self.fits.sort(key=lambda fit: fit[0])

    def try_smaller_scatter(self) -> None:
        """Let the best compete with where a smaller scatter leads.

        Too large a scatter, which wrong branches bring about, makes them cheap.
        """
        model, data, at = self.model, self.data, self.best
        if not model.estimate_scatter or at.scatter < _LEAST_COOLED:
            return
        scatter = _COOLER * at.scatter
        at = replace(at, scatter=scatter)
        for _ in range(2):
            end = descend(model, data, at, at.held, at.weights, scatter, _TRUST)
            at = take_end(at, end, at.held, scatter)
            at = rescan_push_friction(model, data, at, find_branches(model, data, at))
        try:
            cooled = self._settle(at)
        except NumericalError:
            return
        if self._cost(cooled) < self.fits[0][0] - ALIKE:
            # The starts that led to the best would have led here.
            self.fits = [(self._cost(cooled), cooled, self.reached), *self.fits]

    def polish_best(self) -> Settled:
        """The optimum of the marginal likelihood that is the best of those near the best fits."""
        done: list[tuple[float, Settled]] = []
        for cost, at, _ in self.fits:
            if cost > self.fits[0][0] + _NEAR or len(done) == _POLISHED:
                break
            if all(cost - known > ALIKE for known, _ in done):
                done.append((cost, polish(self.model, self.data, at)))
        return min((at for _, at in done), key=lambda at: at.components.criterion)

    def _settle(self, start: Settled) -> Settled:
        done = settle(self.model, self.data, start)
        if self.data.kind != TABLE:
            return done
        return settle_on_best_branches(self.model, self.data, done)

    def _cost(self, done: Settled) -> float:
        if self.data.kind != TABLE:
            return done.components.criterion
        return minus_2_log_likelihood(self.model, self.data, done)


def _start_on_best_branches(model: Model, data: FitData, theta: NDArray) -> Settled:
    """A start at these shared parameters with each push's own mu_s on its best branch.

    They are better than the pushes' residuals make them look, and settling would leave them.
    """
    scatter = _NEW_SCATTER if model.estimate_scatter else model.scatter
    at = replace(first_point(model, data, theta), scatter=scatter)
    everything = np.ones_like(at.held)
    end = descend(model, data, at, everything, at.weights, scatter, _TRUST)
    at = replace(take_end(at, end, everything, scatter), held=at.held)
    return rescan_push_friction(model, data, at, find_branches(model, data, at))
