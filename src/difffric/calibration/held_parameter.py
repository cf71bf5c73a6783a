"""The fits with one parameter held: how -2 log-likelihood rises along it.

The parameter stands on a value, and everything else is fitted anew: the other shared parameters,
each push's start offset. Each push's own mu_s is integrated out where friction of a table or of
free slides scatters (`marginal`), else it is fitted too, and what rises is chi-square. The
variances stay at their estimates.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.marginal.marginal_likelihood import MarginalLikelihood
from difffric.calibration.marginal.polish import fit_others
from difffric.calibration.result import Fit
from difffric.errors import NumericalError
from difffric.estimation.coordinates import NOTHING, has_vanished, to_value
from difffric.estimation.descent import ARRIVED, Settled, descend, linearise_at, take_end
from difffric.estimation.push_friction import rescan_push_friction
from difffric.estimation.stacked_data import RECORDINGS

_TRUST, _TRUST_OF_SAMPLES = 30.0, 1e3
"""How far a descent trusts its linear model at first: far, as it starts beside an optimum, and the
farther with thousands of samples."""
_STEEPEST = 7.0
"""Another parameter that would go along by more than this a unit is not foretold: nothing
determines it, and its slope is noise."""
_RESCUES = 6
"""How often one parameter's fits look for each push's mu_s elsewhere: that takes long."""
_SURPRISE, _ANYHOW = 1.5, 0.5
"""A rise of chi-square above this many times what the standard error says, and above this, is
worth a second look."""
_RELEASES = 4
"""How often parameters are held at their bounds, or taken back inside, for one value."""


class HeldParameter:
    """The optima of everything else at values of one parameter, as far as they were asked for.

    Values are coordinates (`estimation.coordinates`).
    """

    def __init__(self, fit: Fit, label: str):
        """Raises `NumericalError` where the misfit is not finite at the fit itself."""
        state = fit.state
        self.fit, self.label = fit, label
        self.model, self.data, at = state.model, state.data, state.at
        self.j = fit.index(label)
        self.name = fit.names[self.j]
        self.trust = _TRUST_OF_SAMPLES if self.data.kind == RECORDINGS else _TRUST
        self.start = float(at.theta[self.j])
        self.rescues = _RESCUES
        layout = self.model.layout
        self.lower, self.upper = float(layout.lower[self.j]), float(layout.upper[self.j])
        # A damping that runs to zero is held there: chi-square does not depend on it any more.
        self.gone = at.held & (at.theta <= NOTHING)
        self.gone[self.j] = False
        self.slopes = _foretell(fit, self.j)
        self.found: dict[float, tuple[float, Settled]] = {}
        self.likelihood = None
        if self.data.kind != RECORDINGS and at.scatter > 0:
            self.likelihood = MarginalLikelihood(self.model, self.data, at)
            self.base, base = self._fit_marginally(self.likelihood, at, self.start)
            self.found[self.start] = (self.base, base)
            return
        base = self._descend(at, at.held)
        if not np.isfinite(self._chi2(base)):
            raise NumericalError("profile: the misfit is not finite at the fit itself")
        self.base = self._chi2(base)
        self.found[self.start] = (self.base, base)

    @property
    def lowest(self) -> float:
        """Where chi-square is lowest: at the fit, unless that is not at its optimum."""
        return min(self.found, key=lambda x: (self.found[x][0], x != self.start))

    @property
    def variance(self) -> float:
        """Of the parameter's estimate."""
        return float(self.fit.covariance[self.j, self.j])

    @property
    def fall(self) -> float:
        """How far chi-square falls below the fit's."""
        return self.base - self.found[self.lowest][0]

    def rise(self, x: float) -> float:
        """How far chi-square at a known point lies above the lowest."""
        return self.found[x][0] - self.found[self.lowest][0]

    def root(self, x: float) -> float:
        """The root of the rise: where the model is linear, standard deviations from the fit."""
        return float(np.sqrt(max(self.rise(x), 0.0)))

    def value(self, x: float) -> float:
        """The value [SI] of a coordinate."""
        return 0.0 if has_vanished(self.label, x) else float(to_value(self.name, x))

    def hold(self, x: float) -> None:
        """Hold the parameter on x and fit everything else, from the nearest point known."""
        near = min(self.found, key=lambda known: abs(known - x))
        _, at = self.found[near]
        if self.likelihood is not None:
            self.found[x] = self._fit_marginally(self.likelihood, at, x)
            return
        theta = at.theta + np.where(at.held, 0.0, self.slopes[0]) * (x - near)
        theta[self.j] = x
        ahead = replace(at, theta=theta, s_eta=at.s_eta + self.slopes[1] * (x - near))
        expected = (x - self.start) ** 2 / self.variance if self.variance > 0 else 0.0
        best = self._fit_inside(ahead)
        more = not self._chi2(best) - self.base < _SURPRISE * expected + _ANYHOW
        if more and expected > 0 and self.rescues:
            self.rescues -= 1
            # More than expected: perhaps one push stays on the wrong side of a jump.
            plain = at.theta.copy()
            plain[self.j] = x
            best = min(best, self._fit_inside(replace(at, theta=plain)), key=self._cost)
            other = rescan_push_friction(self.model, self.data, best)
            if other is not best:
                best = min(best, self._fit_inside(other), key=self._cost)
        self.found[x] = (self._cost(best), best)

    def _fit_marginally(
        self, likelihood: MarginalLikelihood, at: Settled, x: float
    ) -> tuple[float, Settled]:
        """-2 log-likelihood with the parameter on x, and where the others then are."""
        theta = at.theta + np.where(self.gone, 0.0, self.slopes[0]) * (x - at.theta[self.j])
        theta[self.j] = x
        value, theta = fit_others(likelihood, self.model, at, theta, self.gone, self.j)
        return (value if np.isfinite(value) else np.inf), replace(at, theta=theta)

    def _fit_inside(self, at: Settled) -> Settled:
        """The optimum of everything else, the other parameters within their bounds."""
        layout = self.model.layout
        held = self.gone | at.held
        held[self.j] = True
        for _ in range(_RELEASES):
            beyond = ((at.theta < layout.lower) | (at.theta > layout.upper)) & ~held
            held = held | beyond
            theta = np.where(beyond, np.clip(at.theta, layout.lower, layout.upper), at.theta)
            at = self._descend(replace(at, theta=theta), held)
            if ((at.theta < layout.lower) | (at.theta > layout.upper))[~held].any():
                continue
            inward = self._find_inward(at, held)
            if not inward.any():
                break
            held = held & ~inward
        return at

    def _find_inward(self, at: Settled, held: NDArray) -> NDArray:
        """Which parameters (free,) held at a bound chi-square would take back inside."""
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

    def _cost(self, at: Settled) -> float:
        chi2 = self._chi2(at)
        return chi2 if np.isfinite(chi2) else np.inf

    def _chi2(self, at: Settled) -> float:
        """The penalised sum of squares; what was known of held parameters counts too."""
        layout = self.model.layout
        held = np.where(at.held, 1.0 / layout.prior_sd, 0.0)
        return float(at.end.chi2) + float(((held * (at.theta - layout.start)) ** 2).sum())


def _foretell(fit: Fit, j: int) -> tuple[NDArray, NDArray]:
    """How the others go along with parameter j where the model is linear: d theta (free,) and
    d s_eta (n,) for a unit of its coordinate."""
    model, data, at = fit.state.model, fit.state.data, fit.state.at
    along = np.zeros(len(at.theta))
    if fit.covariance[j, j] > 0:
        along = fit.covariance[:, j] / fit.covariance[j, j]
    along = np.where(np.abs(along) < _STEEPEST, along, 0.0)
    along[j] = 1.0
    linear, P = linearise_at(model, data, at), len(at.theta)
    G = linear.known + np.einsum("gnij,g->nij", linear.groups, 1.0 / at.spreads**2)
    z = G[:, P + 1]
    own = at.scatter**2 / (1.0 + at.scatter**2 * z[:, P + 1])
    return along, -own * (z[:, :P] @ along)
