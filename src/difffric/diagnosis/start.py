"""Where a diagnosis starts: the data, the best plain fit, the program that follows extended models.

A strong effect bends the plain fit and gives it several optima; the search is worth only as much as
the fit that it extends. So the plain fit is begun from several places, and begun again from where
a leading effect has led.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.calibrate import Fit, fit, refine_fit
from difffric.calibration.free_parameters import (
    choose_first_scatter,
    choose_free,
    has_gauge,
)
from difffric.calibration.recording_search import NearStart
from difffric.diagnosis.background.growing_horizon import start_plain_fit
from difffric.diagnosis.data import (
    DiagnosisData,
    blind_to_motion,
    follow_in_columns,
    free_plain,
    place_at,
    place_blocks,
    prepare_data,
)
from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.extended_setup import extend_rig, strip_effects
from difffric.diagnosis.impossible_measurements import find_unreachable
from difffric.diagnosis.inferred.push_offsets import (
    PushOffsets,
    compare_zeros,
    find_push_offsets,
)
from difffric.diagnosis.lack_of_fit import is_misfit_large, measure_lack_of_fit
from difffric.errors import InputError
from difffric.estimation.ensembles import ensemble, ensemble_refits, friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.stacked_data import TABLE
from difffric.measurements.checks import check_data
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.recorded_pusher import reduce_for
from difffric.progress import Tell
from difffric.rig import parameters
from difffric.rig.catalogue import numbers_of
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup, refuse_recorded_motion

_SLIDE_READ = 1e-3
"""Relative error of a free slide's distance where none is known: so small that all by which its
mu_s scatters counts as scatter, and nothing as noise."""
_ROUNDS = 20
"""Steps at most of each fit of the plain model."""
_WORTH, _LEAST_WORTH = 1e-2, 0.01
"""The share of a misfit that a step of the plain calibration has to explain, and by how much a step
has to lower chi-square at least."""
_NOISE, _OFF = 2.0, 5.0
"""Squares per number up to which a recorded push leaves noise, and from which on it is off."""
_SIZES = (0.3, 0.6, 0.85, 1.18, 1.7, 3.0)
"""Shares of an effect's size from which a model that has not arrived is fitted anew."""
_FIRST_ROUNDS, _LAST_ROUNDS, _FINALISTS = 4, 30, 3
"""Steps at most from each of these, those of the leaders after them, and how many lead."""
_BETTER = 1.0
"""By how much -2 log likelihood must be lower for a fit without an effect to be another optimum."""
_SHARE = 0.01
"""The same as a share of what the effect explains; the larger of the two counts."""
_MOST_SHIFTS = 3
"""How often pushes are corrected at most, each time where the next fit asks for it."""


@dataclass(frozen=True)
class SearchStart:
    """What a search starts from."""

    data: DiagnosisData
    own: Setup
    """the plain set-up as it was given"""
    fit: Fit | None
    """of a table or of free slides with it; None: of recordings"""
    known: tuple[str, ...]
    """numbers of the effects that the set-up has already"""
    at: Fits
    """the plain fit, with the effects that the set-up has"""
    guess: Fits
    """the set-up as it was given"""
    offsets: tuple[PushOffsets, ...] = ()
    """what the pushes were corrected by, each time"""


def prepare_start(
    setup: Setup,
    given: Pushes | Recordings,
    tell: Tell,
    *,
    use_data_mass: bool = False,
    skip_bad: bool = False,
) -> SearchStart:
    """Check the data, fit the plain set-up, and compile the program of extended models meanwhile.

    `use_data_mass` and `skip_bad` are those of `diagnose`.

    Raises `InputError` for data that cannot be used.
    """
    own, known = strip_effects(setup)
    plain = own.rig
    if isinstance(given, Recordings):
        checked: Pushes | Recordings = check_data(
            given, plain, use_data_mass=use_data_mass, skip_bad=skip_bad
        )
        reduction = reduce_for(own, checked, skip_bad)
        measured, noise = reduction.pushes, None
    else:
        checked = measured = check_data(
            given, plain, use_data_mass=use_data_mass, skip_bad=skip_bad
        )
        refuse_recorded_motion(own, measured.no_pusher)
        reduction, noise = None, _collect_errors(plain, measured)
    data = prepare_data(plain, measured, reduction, noise)
    combined = is_out_of_reach(data)
    data = follow_in_columns(data) if combined else data
    compiling = Thread(target=(lambda: None) if combined else data.task.model.compile)
    compiling.start()
    fitted = None
    try:
        if reduction is None:
            # One start will do: where the fit is poor, the search begins with more of its own.
            fitted = fit(
                own,
                checked,
                thorough=False,
                use_data_mass=use_data_mass,
                skip_bad=skip_bad,
                tell=lambda what, share: tell(what, 0.25 * share),
            )
    finally:
        compiling.join()
    names = choose_free(own, measured, None)
    scatter, is_estimated = choose_first_scatter(own, len(measured), names, [])
    data = free_plain(data, names, is_estimated)
    mu_s = np.full(len(measured), float(parameters.values(plain)["mu_s"]))
    if not data.task.mu_free and has_gauge(measured):
        mu_s = measured.mu_s_gauge
    guess = _add_known(data.task, place_at(data.task, plain, mu_s, scatter), known)
    if fitted is None:
        tell("fitting the plain rig", 0.1)
        at = start_plain_fit(data, guess)
        data = place_blocks(blind_to_motion(data, plain, at), plain, at)
    else:
        at = place_at(data.task, fitted.rig, fitted.mu_s, fitted.scatter)
        at = _add_known(data.task, at, known)
        guess = replace(guess, scatter=at.scatter)
    return SearchStart(data, own, fitted, tuple(known), at, guess)


def shift_by_offsets(setup: Setup, start: SearchStart, at: Fits, tell: Tell) -> SearchStart | None:
    """Start anew with each recorded push corrected by its own offsets, as its quiet time or the fit
    `at` (an ensemble of one) says; None: it has none, or that was done often enough."""
    data = start.data
    if data.reduction is None or data.measured.motion is not None:
        return None  # nothing was triggered, or it is recorded what drove the push
    if len(start.offsets) == _MOST_SHIFTS:
        return None
    zeros = None if start.offsets else compare_zeros(data.reduction)
    offsets = zeros or find_push_offsets(data.task, at)
    if offsets is None:
        return None
    shifted = offsets.take_from(data.reduction.recordings)
    try:
        anew = prepare_start(setup, shifted, tell, use_data_mass=True)
    except InputError:  # a record that cannot be reduced any more was not off by that
        return None
    return replace(anew, offsets=(*start.offsets, offsets))


def _add_known(task: EnsembleTask, fits: Fits, known: Mapping[str, float]) -> Fits:
    """Return the fits (an ensemble of one) with the numbers of the effects that are known free."""
    coordinates = task.model.coordinates
    extra = coordinates.indices(tuple(known))
    c = fits.c.copy()
    c[0, extra] = coordinates.point(known)
    return replace(fits, c=c, extra=(tuple(extra),))


def calibrate_plain(start: SearchStart, plain: Fits) -> Fit:
    """Return the calibration of the plain set-up, as `calibration` has it; of recordings it begins
    at the plain fit `plain` (an ensemble of one), and is no finer than its misfit is worth.

    Raises `NumericalError` where its misfit is not finite.
    """
    if start.fit is not None:
        return start.fit
    assert start.data.reduction is not None, "only recordings are fitted here first"
    task, own = start.data.task, start.own
    bare = replace(plain, extra=((),))
    near = replace(own, rig=extend_rig(own.rig, task, bare))
    worth = max(_WORTH * measure_lack_of_fit(task, plain).excess, _LEAST_WORTH)
    log_mu = plain.mu[0, task.condition] + plain.own[0]
    beside = NearStart(log_mu, float(plain.scatter[0]), worth)
    return refine_fit(near, start.data.reduction, beside)


def is_out_of_reach(data: DiagnosisData) -> bool:
    """Whether a table of known friction has distances that no k, b and k_v can give: one cause
    alone hardly mends that, and a combination is looked for at once."""
    if data.task.model.kind != TABLE or not np.isfinite(data.measured.mu_s_gauge).all():
        return False
    return bool(find_unreachable(data.measured, data.task.model.plain))


def _collect_errors(rig: Rig, measured: Pushes) -> NDArray:
    """Return the (n, 2) standard errors of F_p [N] and d [m]; NaN where one is not known."""
    if measured.free_slides:
        d, v = measured.sliding_distance, measured.release_velocity
        through = np.nan_to_num(2 * d / v * measured.release_velocity_se)
        own = measured.sliding_distance_se
        own = np.where(np.isnan(own), rig.sensor_errors[1] or _SLIDE_READ * d, own)
        return np.stack([np.full(len(d), np.nan), np.hypot(own, through)], axis=1)
    noise = np.stack([measured.peak_force_se, measured.sliding_distance_se], axis=1)
    default = [np.nan if x is None else x for x in rig.sensor_errors]
    return np.where(np.isnan(noise), default, noise)


def fit_plain_model(task: EnsembleTask, start: Fits, guess: Fits) -> Fits:
    """Return the best of the fits that begin from `start`; where that leaves a large misfit, also
    from there with equal mu_s, and from `guess`, the set-up's own numbers (all ensembles of
    one)."""
    fits = ensemble_refits.refit(task, start, _ROUNDS)
    if not is_misfit_large(task, fits):
        again = friction_scan.rescan_loose_pushes(task, fits)
        fits = ensemble_refits.refit_past_jumps(task, again, _ROUNDS)
    else:
        level = replace(start, own=np.zeros_like(start.own))
        more = ensemble_refits.refit(task, ensemble.join(level, guess), _ROUNDS)
        every = ensemble.join(fits, more)
        best = np.argmin(ensemble.criterion(task, every))
        fits = _rescan_and_refit(task, every.pick(best), fine=True)
    better = find_better_optimum(task, fits, guess) if _is_push_off(task, fits) else None
    return fits if better is None else better


def _is_push_off(task: EnsembleTask, fits: Fits) -> bool:
    """Whether few recorded pushes fit far worse than most, which leave noise: their own mu_s, or
    all else, are in a wrong place. Bristles without any compliance had been named for that, as
    their fit was led elsewhere."""
    if not task.model.recordings:
        return False
    squares = fits.gram[0, :, :, -1, -1] / fits.spread[0] ** 2
    left = (squares / np.maximum(task.counts, 1.0)).max(axis=1)
    return bool(np.median(left) < _NOISE < _OFF < left.max())


def find_better_base(
    task: EnsembleTask, base: Fits, found: Sequence[CandidateCause]
) -> Fits | None:
    """Return a better fit than `base` without any of the leading effects `found`, begun from where
    they led, or None.

    What such a fit explains too was the failure of `base`, and not the effect's merit.
    """
    if not found:
        return None
    before, bare = float(ensemble.criterion(task, base)[0]), []
    for candidate in found[:2]:
        index = task.model.coordinates.indices(numbers_of(candidate.effect))
        c = candidate.fits.c.copy()
        c[0, index] = base.c[0, index]
        bare.append(replace(candidate.fits, c=c, extra=base.extra, gram=None, damping=None))
    fits = ensemble_refits.refit(task, ensemble.join(*bare), _ROUNDS)
    fits = _rescan_and_refit(task, fits)
    after = ensemble.criterion(task, fits)
    for j, candidate in enumerate(found[: fits.m]):
        if after[j] < before - max(_BETTER, _SHARE * candidate.drop):
            return fits.pick(j)
    return None


def find_better_optimum(task: EnsembleTask, fits: Fits, guess: Fits) -> Fits | None:
    """Return a better optimum of the model of `fits`, which has not arrived at its noise floor, or
    None; `guess` is the set-up as it was given (all ensembles of one).

    It is begun from other sizes of the model's effects, each with the pushes' own mu_s as they are
    and with equal ones; from `guess`; and from a fit to the pushes that fit best, as a push on a
    wrong branch of its mu_s bends what all share.
    """
    bare = replace(fits, gram=None, residual=None, damping=None)
    index = list(fits.extra[0])
    c = guess.c.copy()
    c[0, index] = fits.c[0, index]
    away = replace(bare, c=c, mu=guess.mu, own=guess.own)
    starts = [replace(bare, own=np.zeros_like(bare.own)), away, _fit_best_pushes(task, fits)]
    coordinates = task.model.coordinates
    for i in index:
        for size in _SIZES:
            c = fits.c.copy()
            c[0, i] = np.clip(size * c[0, i], *coordinates.bounds(coordinates.names[i]))
            starts += [replace(one, c=c) for one in (bare, starts[0])]
    every = ensemble_refits.refit(task, ensemble.join(*starts), _FIRST_ROUNDS)
    first = np.argsort(ensemble.criterion(task, every))[:_FINALISTS]
    every = ensemble_refits.refit(task, every.pick(first), _LAST_ROUNDS)
    every = _rescan_and_refit(task, ensemble.join(fits, every), fine=True)
    value = ensemble.criterion(task, every)
    best = int(np.argmin(value))
    before = float(ensemble.criterion(task, fits)[0])
    return every.pick(best) if value[best] < before - _BETTER else None


def _fit_best_pushes(task: EnsembleTask, fits: Fits) -> Fits:
    """Return a start for all pushes from a fit (an ensemble of one) to the half of them that fits
    best, the others' own mu_s looked for there."""
    cost = np.einsum("nk,k->n", fits.gram[0, :, :, -1, -1], 1.0 / fits.spread[0] ** 2)
    some = np.sort(np.argsort(cost / np.maximum(task.counts.sum(axis=1), 1.0))[: -(-task.n // 2)])
    at = replace(fits, gram=None, residual=None, damping=None)
    at = ensemble.evaluate(task, ensemble_refits.refit(task, at, _LAST_ROUNDS, some))
    at = friction_scan.rescan_bad_pushes(task, at, fine=True)
    return replace(at, gram=None, residual=None, damping=None)


def _rescan_and_refit(task: EnsembleTask, fits: Fits, fine: bool = False) -> Fits:
    """Refit with each push's own mu_s looked for afresh, on a `fine` grid or not, those fits for
    which that leads to a better one."""
    again = friction_scan.rescan_bad_pushes(task, fits, fine=fine)
    moved = np.flatnonzero((again.own != fits.own).any(axis=1))
    if not len(moved):
        return fits
    again = ensemble_refits.refit(task, again.pick(moved), _ROUNDS)
    better = ensemble.criterion(task, again) < ensemble.criterion(task, fits.pick(moved))
    return ensemble_refits.replace_fits(fits, moved[better], again.pick(np.flatnonzero(better)))
