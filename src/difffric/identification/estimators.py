"""`identify`: mu_s of each push by every way that its data allow, each with its standard error.

From the force, from the distance, by equation (7), by the statistically optimal combination, from
the free slide, and from whole recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from difffric.estimation import coordinates
from difffric.estimation.open_parameters import describe_assumed_ratio
from difffric.identification.agreement import describe_agreement, judge_recording
from difffric.identification.combination import combine
from difffric.identification.estimates import NONE, Estimates, Identified, PushFriction
from difffric.identification.free_slide import estimate_by_slides
from difffric.identification.inversion import BRACKET, Inversion
from difffric.identification.resolved_pushes import Calibration, ResolvedPushes
from difffric.known_so_far import tell_known
from difffric.measurements.checks import check_data
from difffric.measurements.latched_distances import describe_latch
from difffric.measurements.pusher_tracking import describe_tracking
from difffric.measurements.pushes import Pushes
from difffric.measurements.recorded_motion import describe_motion
from difffric.measurements.recordings import Recordings
from difffric.number_text import format_number
from difffric.progress import Tell, silent
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup, check_rig, refuse_recorded_motion
from difffric.simulation.segments import Integrator

if TYPE_CHECKING:
    from difffric.calibration.result import Fit
    from difffric.measurements.reduction.reduce import Reduction

_NAMED = 8
"""Pushes whose mu_s a person is told where an identification is stopped; a file has all."""


def identify(
    rig: Rig | Setup | Fit,
    data: Pushes | Recordings,
    *,
    range_ratio: float | None = None,
    bracket: tuple[float, float] = BRACKET,
    use_data_mass: bool = False,
    skip_bad: bool = False,
    tell: Tell = silent,
    integrator: Integrator | None = None,
) -> Identified:
    """mu_s of each push: from F_p, from d, by (7), the optimal combination; from a recording
    also from all its samples; from a release speed and d also from the free slide alone.

    The errors of F_p and d are the pushes' own, else the fit's spreads, else the sensors'
    noise. A `Fit`'s covariance is carried through the exact derivatives (it is shared by force
    and distance, and the optimal combination takes that into account), of a `Setup` the
    standard errors that it states, as if they were uncorrelated.
    `range_ratio` is equation (7)'s ratio of the ranges [N/m]; by default over 500-5000 mm/min
    and mu_s 0.05-0.30 of this rig. `tell(what, share done)` hears of the progress.

    Where several mu_s give the measured d, the one whose F_p is nearest to the measured one is
    taken (without a force, the smallest), and all stand in `alternatives`.

    A whole recording that the model does not follow is passed over for force and distance, or its
    standard error widened where they give nothing (`agreement`); the row's `reason` says so, and
    `notes` where the ways differ.

    Raises `InputError` for data that cannot be used with the rig (`measurements.checks`).
    """
    known = Calibration.read(rig)
    check_rig(known.rig)
    reduction = None
    if isinstance(data, Recordings):
        data = check_data(data, known.rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
        # Here, as a table needs neither this nor the fit of recordings, with which JAX comes.
        from difffric.measurements.reduction.recorded_pusher import reduce_for

        tell("reducing the recordings", 0.0)
        reduction = reduce_for(known.setup, data, skip_bad)
        pushes = reduction.pushes
    else:
        pushes = check_data(data, known.rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
        refuse_recorded_motion(known.setup, pushes.no_pusher)
    if not pushes.free_slides:
        tell("inverting forces and distances", 0.2)
    resolved = ResolvedPushes.of(known, pushes, integrator=integrator, range_ratio=range_ratio)
    if pushes.free_slides:
        nothing = (None, NONE, NONE, NONE, NONE, None, (), None, None)
        answers = [PushFriction(np.nan, c, *nothing) for c in pushes.condition]
    else:
        force, distance = resolved.invert(bracket)
        if reduction is not None:
            distance = _explain_missing(distance, pushes, reduction)
        gradient, regimes = resolved.differentiate(force, distance)
        combination = combine(resolved, force, distance, gradient, regimes)
        answers = [combination.row(i) for i in range(len(pushes))]
    answers = _add_slides(resolved, answers)
    if reduction is not None:
        tell_known("mu_s by force and distance", *_describe_known(answers))
        tell("fitting every sample", 0.6)
        answers = _add_recordings(known, resolved, reduction, answers)
    tell("done", 1.0)
    notes = describe_agreement(answers)
    if reduction is not None:
        notes += describe_motion(reduction.recordings)
        notes += describe_tracking(reduction.recordings, known.rig.pusher.stroke)
        notes += describe_latch(reduction)
    if "mu_k_over_mu_s" not in known.names:
        mu_s = np.array([np.nan if x.best.value is None else x.best.value for x in answers])
        notes += describe_assumed_ratio(known.rig, pushes, mu_s)
    return Identified(tuple(answers), pushes.skipped, notes)


def _explain_missing(
    distance: Sequence[Inversion], pushes: Pushes, reduction: Reduction
) -> list[Inversion]:
    """What the distances say of mu_s; where the reduction gives none, with its own reason."""
    missing = np.isnan(pushes.sliding_distance)
    return [
        replace(x, reason=one.reason) if none and one.reason else x
        for x, none, one in zip(distance, missing, reduction.details, strict=True)
    ]


def _describe_known(answers: Sequence[PushFriction]) -> tuple[str, list[dict]]:
    """What is known of the pushes before their samples are fitted: for a person, and for a file."""
    found = [format_number(one.best.value) for one in answers[:_NAMED]]
    more = ", ..." if len(answers) > _NAMED else ""
    said = f"{', '.join(found)}{more} ({len(answers)} pushes)"
    return said, [one.as_dict() for one in answers]


def _add_slides(
    resolved: ResolvedPushes, answers: Sequence[PushFriction]
) -> Sequence[PushFriction]:
    """The answers with what the free slides say, where a release speed was measured."""
    found = estimate_by_slides(resolved)
    if found is None:
        return answers
    pushes, out = resolved.pushes, []
    measured = np.isfinite(pushes.release_velocity) & np.isfinite(pushes.sliding_distance)
    for i, x in enumerate(answers):
        slide, reason = found.row(i), x.reason
        if slide.value is None and pushes.free_slides:
            reason = "no mu_s gives this distance: k_v alone would stop the part sooner"
            if not measured[i]:
                reason = "a free slide needs its release speed and its distance"
        out.append(replace(x, mu_s_slide=slide, reason=reason))
    return out


def _add_recordings(
    known: Calibration,
    resolved: ResolvedPushes,
    reduction: Reduction,
    answers: Sequence[PushFriction],
) -> Sequence[PushFriction]:
    """The answers with what all samples say."""
    from difffric.identification.whole_recording import fit_recordings

    guess = np.array([x.mu_s_optimal.value or x.mu_s_force.value or np.nan for x in answers])
    rigs = [known.of(condition)[0] for condition in resolved.pushes.condition]
    found = fit_recordings(rigs, reduction, guess, resolved.models.integrator)
    every = coordinates.names(known.rig)
    J = found.by_coordinate[:, [every.index(n) for n in known.names]]
    shared = found.mu_s[:, None] * np.einsum("ni,nij->nj", J, resolved.roots)
    own = found.mu_s * np.sqrt(found.own_variance)
    estimates = Estimates(found.mu_s, np.sqrt(own**2 + np.sum(shared**2, axis=1)), shared)
    whole = [
        replace(
            x,
            mu_s_trace=estimates.row(i),
            trace_reduced_chi2=float(found.reduced_chi2[i]),
            name=reduction.recordings[i].name,
        )
        for i, x in enumerate(answers)
    ]
    return [judge_recording(x, float(error)) for x, error in zip(whole, own, strict=True)]
