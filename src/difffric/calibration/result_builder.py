"""The fit that users see, built from where a search settled: error bars, notes, doubts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.calibration.result import Fit, FitState
from difffric.estimation.coordinates import NOTHING, Layout
from difffric.estimation.descent import Model, Settled, clip_starts, linearise_at, start_offsets
from difffric.estimation.open_parameters import describe_assumed_ratio
from difffric.estimation.stacked_data import RECORDINGS, FitData
from difffric.measurements.pushes import Pushes
from difffric.measurements.reduction.reduce import Reduction
from difffric.rig import parameters
from difffric.rig.setup import Setup

_ABSURD_SCATTER = 0.5
"""Relative scatter of mu_s beyond which it is no property of a rig: it hides a misfit."""
_ABSURD_CHI2 = 10.0
"""Reduced chi-square beyond which an optimum counts only where most starts reach it."""
_UNLIKELY = 1e-3
"""The probability of chi-square below which a misfit is told, where the noise is known."""
_ABSURD_SPREAD = 0.3
"""An estimated spread of F_p or d beyond this share of their median is no error of measurement."""
_SURPRISING = 3.3
"""Standard deviations of chi-square beyond which a misfit is told (p < 5e-4)."""


def build_fit(
    setup: Setup,
    pushes: Pushes,
    reduction: Reduction | None,
    state: FitState,
    reached: tuple[int, int],
    notes: Sequence[str],
) -> Fit:
    """The fit, with its error bars and notes.

    `reduction` is that of recordings; `reached` says how many starts led to the optimum, of how
    many.
    """
    model, data, at = state.model, state.data, state.at
    n, layout, c = data.n, model.layout, at.components
    spread = dict(zip(data.groups, c.spreads.tolist(), strict=True))
    log_mu = (layout.fixed + layout.selection @ at.theta)[:, 0] + at.s_eta
    F, d = np.asarray(at.end.model)[:n].T
    fitted = int(np.sum(~at.held)) + (n if model.free_start else 0)
    offsets = n if data.kind == RECORDINGS else 0
    freedom = data.samples - fitted - offsets
    absurd = _find_absurd(model, at, freedom, reached)
    doubts = _note_doubts(data, at, freedom, reduction)
    notes = [*notes, *absurd, *doubts, *_note_bounded_starts(model, data, at, reduction)]
    rig = parameters.with_values(setup.rig, _average_values(layout, at))
    if "mu_s" in layout.names and "mu_k_over_mu_s" not in layout.names:
        notes += describe_assumed_ratio(rig, pushes, np.exp(log_mu))
    return Fit(
        rig=rig,
        kind=data.kind,
        free=layout.labels,
        names=layout.names,
        theta=at.theta,
        held=tuple(x for x, on in zip(layout.labels, at.held, strict=True) if on),
        covariance=c.covariance,
        ahead=np.where(at.held, c.step, 0.0),
        freedom=c.freedom,
        scatter=at.scatter,
        scatter_se=float(c.relative_errors[0] * at.scatter) if at.scatter else np.nan,
        spread_force=spread.get("force", np.nan),
        spread_distance=spread.get("distance", np.nan),
        chi2=c.chi2,
        degrees_of_freedom=freedom,
        converged=at.settled and not absurd,
        starts_at_optimum=reached,
        conditions=tuple(pushes.condition),
        mu_s=np.exp(log_mu),
        mu_s_se=np.exp(log_mu) * _propagate_errors(model, data, at),
        start=start_offsets(at),
        peak_force=F,
        sliding_distance=d,
        noise={} if reduction is None else _describe_noise(reduction),
        samples=data.samples,
        left_out=data.left_out,
        notes=tuple(notes),
        skipped=pushes.skipped,
        setup=setup,
        state=state,
        pushes=pushes,
        push_names=() if reduction is None else tuple(r.name for r in reduction.recordings),
    )


def _average_values(layout: Layout, at: Settled) -> dict[str, float]:
    """The fitted values [SI] by name.

    A parameter with a value for each condition has their mean, one that ran towards zero is zero.
    """
    names, found = layout.names, layout.value(at.theta)
    new = {}
    for name in dict.fromkeys(names):
        new[name] = float(
            np.mean([v for v, x in zip(found.values(), names, strict=True) if x == name])
        )
    for name, held, x in zip(names, at.held, at.theta, strict=True):
        if held and x <= NOTHING:
            new[name] = 0.0
    return new


def _find_absurd(model: Model, at: Settled, freedom: int, reached: tuple[int, int]) -> list[str]:
    """Why where the search settled is no answer, though it settled."""
    out = []
    reasons = (
        "an effect that the model does not have, data that do not belong together, a wrong stroke "
        "or unit, or a poor start"
    )
    if model.estimate_scatter and at.scatter > _ABSURD_SCATTER:
        out.append(
            f"not converged: a scatter of mu_s of {100 * at.scatter:.0f} % is the sign of a "
            f"misfit; possible reasons: {reasons}"
        )
    chi2, (there, starts) = at.components.chi2 / max(freedom, 1), reached
    if chi2 > _ABSURD_CHI2 and 2 * there < starts:
        out.append(
            f"not converged: {there} of {starts} starts reached the best result, and its reduced "
            f"chi-square is {chi2:.3g}; possible reasons: {reasons}"
        )
    return out


def _note_doubts(
    data: FitData, at: Settled, freedom: int, reduction: Reduction | None
) -> list[str]:
    """What a reader should know of this optimum."""
    notes = []
    if not at.settled:
        notes.append("the search did not settle: this may not be the optimum")
    if not at.smooth:
        notes.append(
            "the optimum lies at a change of regime of one push or more, where derivatives "
            "jump: error bars hold for one side of it"
        )
    notes += _note_spreads(data, at)
    if freedom > 0 and not data.groups:
        chi2 = at.components.chi2
        sigma = np.sqrt(_chi2_variance(freedom, reduction))
        by_noise = chi2 / freedom - 1 > _SURPRISING * sigma / freedom
        if scipy.stats.chi2.sf(chi2, freedom) < _UNLIKELY and by_noise:
            notes.append(
                f"chi-square is {chi2 / freedom:.3g} times what the noise explains: the model "
                "lacks something (difffric diagnose looks for it), the noise is larger than "
                "stated, or this is not the optimum"
            )
    return notes


def _note_bounded_starts(
    model: Model, data: FitData, at: Settled, reduction: Reduction | None
) -> list[str]:
    """Which start offsets stand at the bound of what their recording holds."""
    bounded = np.flatnonzero(clip_starts(model, data, at.start)[1])
    if reduction is None or not len(bounded):
        return []
    offsets, named = start_offsets(at), reduction.recordings
    which = ", ".join(
        f"{named[i].name or f'push {i + 1}'} {offsets[i]:.3g} s" for i in bounded[:3].tolist()
    )
    rest = f" and {len(bounded) - 3} more" if len(bounded) > 3 else ""
    return [
        f"the start offset is at the bound of what the recording holds ({which}{rest}): the model "
        "does not follow the push, or t = 0 is not the start of the pusher's motion"
    ]


def _note_spreads(data: FitData, at: Settled) -> list[str]:
    """Which estimated spreads are absurd beside what was measured."""
    notes, seen = [], np.asarray(data.pushes.measured)[: data.n] if data.groups else None
    for g, (name, spread) in enumerate(zip(data.groups, at.components.spreads, strict=True)):
        typical = float(np.median(np.abs(np.asarray(seen)[data.group == g])))
        if spread > _ABSURD_SPREAD * typical:
            what, scale, unit = ("F_p", 1.0, "N") if name == "force" else ("d", 1e3, "mm")
            notes.append(
                f"the spread of {what} was estimated as {scale * spread:.3g} {unit}, where a "
                f"typical {what} is {scale * typical:.3g} {unit}: this is the sign of a misfit, or "
                "of data that do not belong together, and not an error of measurement"
            )
    return notes


def _chi2_variance(freedom: int, reduction: Reduction | None) -> float:
    """The variance of chi-square: its own, and that of noise levels which are estimates."""
    own = 2.0 * freedom
    if reduction is None:
        return own
    quiet = [x.n for r in reduction.details[:1] for x in (r.noise_force, r.noise_position) if x]
    return own + sum((freedom / len(quiet)) ** 2 * 2 / max(n, 2) for n in quiet)


def _describe_noise(reduction: Reduction) -> dict[str, dict[str, float]]:
    """Level and correlation of the channels' noise, of the first push that has them."""
    out = {}
    for name in ("force", "position"):
        known = [getattr(x, f"noise_{name}") for x in reduction.details]
        known = [x for x in known if x is not None]
        if known:
            out[name] = {
                "standard_deviation": float(np.median([x.level for x in known])),
                "correlation": float(np.median([x.correlation for x in known])),
            }
    return out


def _propagate_errors(model: Model, data: FitData, at: Settled) -> NDArray:
    """Relative standard error of each push's own mu_s (n,), with what the errors of the shared
    parameters add to it."""
    P = model.layout.n_free
    felt = ~(at.held & (at.theta <= NOTHING))
    L = linearise_at(model, data, replace(at, held=~felt))
    G = L.known + np.einsum("gnij,g->nij", L.groups, 1.0 / at.components.spreads**2)
    column = G[:, :, P]
    on = G[:, P, P] > 0
    G = G - np.einsum("ni,nj->nij", column, column / np.where(on, G[:, P, P], 1.0)[:, None])
    own = at.scatter**2 / (1 + at.scatter**2 * np.maximum(G[:, P + 1, P + 1], 0))
    J = (model.layout.selection * felt)[:, 0] - own[:, None] * G[:, P + 1, :P]
    return np.sqrt(own + np.einsum("np,pq,nq->n", J, at.components.covariance, J))
