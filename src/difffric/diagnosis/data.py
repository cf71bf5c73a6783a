"""The pushes as a diagnosis takes them, and the plain rig from which it starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute.pytrees import pick
from difffric.estimation.block_means import UnevenBlocks, stack_uneven
from difffric.estimation.effect_coordinates import PLAIN, Coordinates
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.extended_model import PRESLIDING, ExtendedModel
from difffric.estimation.following.answer_by_program import StackedPushes
from difffric.estimation.following.answer_in_columns import list_served
from difffric.estimation.following.motion_errors import blind_blocks
from difffric.estimation.residuals import set_stroke
from difffric.estimation.stacked_data import RECORDINGS, SLIDES, TABLE, find_strokes
from difffric.measurements.pushes import Pushes
from difffric.measurements.reduction.reduce import Reduction
from difffric.rig import parameters
from difffric.rig.catalogue import CATALOGUE, FORCE, PROBE, PUSHER, RATIO, extended, numbers_of
from difffric.rig.rig import Rig
from difffric.rig.scales import Scales
from difffric.simulation.column_traces import find_bends
from difffric.units import GRAVITY

NOT_IN_RECORDINGS = ("sample_clipping", "release_threshold", "release_latch")
"""Effects that only reduced numbers have."""
IN_SLIDES = ("quadratic_drag", "stribeck", "friction_drift", "normal_force")
"""Effects that a free slide shows, whose place on the rails is not known."""
_PUSHERS = tuple(e for e, one in CATALOGUE.items() if one.component == PUSHER)
"""Effects that a recorded motion leaves no room for."""
_FIRST_NOISE = 0.02
"""Noise that is assumed where it is to be estimated, as a share of the largest number."""
_SAME = 1e-6
"""Relative difference up to which masses, or rests, are the same."""
_FEWEST_FOR_DRIFT = 3
"""Pushes that show a drift at least: fewer are a line whatever they are."""
_SLIDE = 1e-3
"""How far a part slides [m], about, where no distance was measured."""
_UNSTOPPED = 10.0
"""Compressions of the contact that a tip travels, about, where no stop is known."""
_BEYOND = 1.2
"""A compression that is thought of, over the one at the largest force."""
_LEAST_SCATTER = 1e-4
"""Relative scatter of mu_s from which a search starts at least, so that it can grow."""
SUBSET = 6
"""Pushes that a scan looks at: enough speeds to tell effects apart, at a fraction of the cost."""


@dataclass(frozen=True)
class DiagnosisData:
    """What is compared: the task, its scales, and the effects that can be looked for."""

    task: EnsembleTask
    scales: Scales
    measured: Pushes
    looked_for: tuple[str, ...]
    impossible: dict[str, str]
    """effects that these data cannot show, with the reason"""
    reduction: Reduction | None
    """of recordings; None: a table or free slides"""


def prepare_data(
    rig: Rig, measured: Pushes, reduction: Reduction | None, noise: NDArray | None = None
) -> DiagnosisData:
    """Set the data of a table, of free slides or of recordings against a plain rig.

    `noise` (n, 2) are the standard errors of F_p [N] and d [m] of a table, NaN where they are not
    known; recordings have a `reduction` instead. No parameter is free yet but mu_s.
    """
    slides = measured.free_slides
    if slides:
        measured = replace(measured, velocity=measured.release_velocity)
    n = len(measured)
    _, strokes = find_strokes(rig, measured.stroke)
    order = measured.order if np.isfinite(measured.order).all() else np.arange(n, dtype=float)
    span = np.ptp(order)
    mass = np.where(np.isnan(measured.mass), float(rig.mass), measured.mass)
    impossible = _list_impossible(measured, reduction, mass, span, slides)
    if reduction is None:
        noise = np.full((n, 2), np.nan) if noise is None else noise
        data, counts, open_ = _stack_table(measured, noise)
        left_out, kind = ((PRESLIDING,), SLIDES) if slides else ((), TABLE)
    else:
        values = parameters.values(rig)
        frequency = np.sqrt(float(values["k_N_per_m"]) / mass.min())
        data = stack_uneven(reduction.recordings, reduction.details, strokes, frequency)
        if measured.motion is not None:
            data = blind_blocks(data, measured.velocity, reduction.recordings, None)
        counts = _count_blocks(data)
        open_ = (False, False)
        # A recorded motion is the whole motion: no effect of a pusher stands around it.
        left_out = NOT_IN_RECORDINGS if measured.motion is None else (*NOT_IN_RECORDINGS, *_PUSHERS)
        kind = RECORDINGS
    pushes = StackedPushes(
        velocity=measured.velocity,
        mass=mass,
        stroke=strokes if measured.motion is None else measured.motion,
        share=(order - order.min()) / (span or 1.0),
        rest=np.nan_to_num(measured.rest_before),
        data=data,
        until=np.full(len(mass), np.inf),
    )
    names = list(dict.fromkeys(measured.condition))
    task = EnsembleTask(
        model=_extend_by_all(rig, pushes, kind, left_out, measured.motion),
        shared=(),
        condition=np.array([names.index(c) for c in measured.condition]),
        open_spread=open_,
        counts=counts,
    )
    looked_for = tuple(e for e in (*CATALOGUE, RATIO) if e not in left_out and e not in impossible)
    scales = _estimate_scales(rig, measured, reduction, strokes, mass)
    return DiagnosisData(task, scales, measured, looked_for, impossible, reduction)


def place_blocks(data: DiagnosisData, plain: Rig, fits: Fits) -> DiagnosisData:
    """Return the data of recordings in blocks none of which reaches over a bend of the force of the
    plain rig with the numbers of `fits` (an ensemble of one): a part that turns lets go of the
    damper within a contact, which no sample tells.

    The data stay as they are where the plain rig has no closed form, or a motion is recorded."""
    task, reduction = data.task, data.reduction
    if reduction is None or data.measured.motion is not None or not plain.affine:
        return data
    pushes = task.model.pushes
    values = task.model.coordinates.values(fits.c[0], PLAIN)
    given = dict(zip(PLAIN, map(float, values), strict=True))
    given |= {"mu_s": np.exp(fits.mu[0, task.condition] + fits.own[0]), "mass_kg": pushes.mass}
    rig = set_stroke(parameters.with_values(plain, given), pushes.stroke)
    bends = find_bends(rig, pushes.velocity, task.n)
    frequency = np.sqrt(given["k_N_per_m"] / pushes.mass.min())
    details = reduction.details
    blocks = stack_uneven(reduction.recordings, details, pushes.stroke, frequency, bends)
    if any(new.y.shape != old.y.shape for new, old in zip(blocks, pushes.data, strict=True)):
        return data  # more than the compiled program has room for
    model = replace(task.model, pushes=pushes._replace(data=blocks))
    return replace(data, task=replace(task, model=model, counts=_count_blocks(blocks)))


def _count_blocks(blocks: Sequence[UnevenBlocks]) -> NDArray:
    """How many block means (n, 2) force and position have."""
    return np.stack([(one.a > 0).sum(axis=1) for one in blocks], axis=1).astype(float)


def blind_to_motion(data: DiagnosisData, plain: Rig, fits: Fits) -> DiagnosisData:
    """Return the data blind to what the errors of recorded motions do to the pushes of a plain rig
    with the numbers of `fits` (an ensemble of one); as they are, where none is recorded."""
    if data.measured.motion is None or data.reduction is None:
        return data
    task = data.task
    values = task.model.coordinates.values(fits.c[0], PLAIN)
    shared = dict(zip(PLAIN, map(float, values), strict=True))
    mu_s = np.exp(fits.mu[0, task.condition] + fits.own[0])
    pushes = task.model.pushes
    rigs = [
        parameters.with_values(plain, shared | {"mu_s": float(mu), "mass_kg": float(mass)})
        for mu, mass in zip(mu_s, pushes.mass, strict=True)
    ]
    blocks = blind_blocks(pushes.data, pushes.velocity, data.reduction.recordings, rigs)
    model = replace(task.model, pushes=pushes._replace(data=blocks))
    return replace(data, task=replace(task, model=model))


def follow_in_columns(data: DiagnosisData) -> DiagnosisData:
    """Return the same data, of a table, followed by NumPy: nothing is compiled, and only those
    effects are looked for that can be followed so."""
    model = data.task.model
    served = {*list_served(model.plain), RATIO}
    looked_for = tuple(effect for effect in data.looked_for if effect in served)
    task = replace(data.task, model=replace(model, in_columns=True))
    return replace(data, task=task, looked_for=looked_for)


def _extend_by_all(
    rig: Rig, pushes: StackedPushes, kind: str, left_out: Sequence[str], motion: Any
) -> ExtendedModel:
    """Return the model of a plain rig with all effects of the catalogue at their nulls, but for
    those left out, its tip moving as the stacked `motion` has it, if there is one. Bristles
    have no null: the model adds them itself where they are asked for."""
    every = {e: {} for e in CATALOGUE if e not in left_out}
    plain = parameters.with_stroke(rig, 1.0 if motion is None else pick(motion, 0))
    coordinates = Coordinates.of(extended(plain, every))
    whole = extended(plain, {e: keys for e, keys in every.items() if e != PRESLIDING})
    return ExtendedModel(coordinates, whole, pushes, kind, plain=plain)


def choose_subset(task: EnsembleTask, most: int = SUBSET) -> NDArray:
    """The numbers of some `most` pushes for a scan: over all speeds, and one of each condition."""
    v = np.asarray(task.model.pushes.velocity)
    if task.n <= most:
        return np.arange(task.n)
    order = np.lexsort((np.arange(task.n), v))
    chosen = set(order[np.linspace(0, task.n - 1, most).round().astype(int)].tolist())
    for k in range(task.conditions):  # one of each condition at least
        if not chosen & set(np.flatnonzero(task.condition == k).tolist()):
            chosen.add(int(np.flatnonzero(task.condition == k)[0]))
    return np.array(sorted(chosen))


def _stack_table(
    measured: Pushes, noise: NDArray
) -> tuple[tuple[NDArray, NDArray], NDArray, tuple[bool, bool]]:
    """Return the numbers of a table and their weights (n, 2), how many numbers there are (n, 2),
    and whether the noise of F_p and of d is to be estimated."""
    both = np.stack([measured.peak_force, measured.sliding_distance], axis=1)
    there = np.isfinite(both)
    unknown = np.any(there & np.isnan(noise), axis=0)
    open_ = bool(unknown[0]), bool(unknown[1])
    size = [np.abs(both[there[:, k], k]).max(initial=1e-9) for k in (0, 1)]
    sd = np.where(np.isnan(noise), _FIRST_NOISE * np.array(size), noise)
    weight = np.where(there, 1.0 / sd, 0.0)
    return (np.where(there, both, 0.0), weight), there.astype(float), open_


def _list_impossible(
    measured: Pushes, reduction: Reduction | None, mass: NDArray, span: float, slides: bool
) -> dict[str, str]:
    """List the effects that these data have no way to show, each with the reason.

    `mass` (n,) [kg]; `span` is how far apart the pushes are in order.
    """
    out: dict[str, str] = {}
    if slides:
        some = (*CATALOGUE, RATIO)
        out = dict.fromkeys(some, "free slides have no push, and no known place on the rails")
        out = {name: why for name, why in out.items() if name not in IN_SLIDES}
    if not np.isfinite(measured.rest_before).all():
        out["static_dwell"] = "the rest before each push (rest_before_s) is not recorded"
    elif np.ptp(np.log1p(measured.rest_before)) < _SAME:
        out["static_dwell"] = "every push had the same rest before it"
    if span == 0 or len(measured) < _FEWEST_FOR_DRIFT:
        out["friction_drift"] = "too few pushes to show a drift"
    if np.ptp(mass) < _SAME * mass.max():
        out["normal_force"] = (
            "every push had the same mass: it cannot be told from mu_s unless the mass varies"
        )
    if measured.motion is not None:
        out |= dict.fromkeys(_PUSHERS, "the pusher's motion is the recorded one")
    if reduction is not None:
        for name in NOT_IN_RECORDINGS:
            out[name] = (
                "recordings hold all samples: only tables whose F_p and d another program read off "
                "can show this"
            )
    for component, there, what in (
        (FORCE, measured.peak_force, "force"),
        (PROBE, measured.sliding_distance, "position"),
    ):
        if not np.isfinite(there).any() and not slides:
            own = [e for e, one in CATALOGUE.items() if one.component == component]
            out |= {e: f"no {what} was recorded" for e in own if e not in out}
    return out


def _estimate_scales(
    rig: Rig, measured: Pushes, reduction: Reduction | None, strokes: NDArray, mass: NDArray
) -> Scales:
    """Estimate what the pushes are like from what was measured; `strokes` [m], `mass` [kg] (n,)."""
    F, d = measured.peak_force, measured.sliding_distance
    mu = float(parameters.values(rig)["mu_s"])
    peak = float(np.nanmax(F)) if np.isfinite(F).any() else mu * float(mass.max()) * GRAVITY
    slid = float(np.nanmax(d)) if np.isfinite(d).any() else _SLIDE
    contact = peak / float(parameters.values(rig)["k_N_per_m"])
    finite = strokes[np.isfinite(strokes)]
    travel = float(np.median(finite)) if len(finite) else _UNSTOPPED * contact
    tips = np.full(len(measured), travel)
    if reduction is not None:
        released = np.array([one.release_time for one in reduction.details])
        gone = np.minimum(measured.velocity * released, strokes)
        tips = np.where(gone > 0, gone, tips)  # none: it rests against the tip
    return Scales(
        mass=float(mass.mean()),
        mu_s=mu,
        fastest=float(measured.velocity.max()),
        slowest=float(measured.velocity.min()),
        peak=peak,
        reach=travel + slid,
        travel=travel,
        compression=_BEYOND * contact,
        ways=np.where(np.isfinite(strokes), strokes, travel) + np.nan_to_num(d),
        tips=tips,
    )


def free_plain(data: DiagnosisData, names: Sequence[str], estimates_scatter: bool) -> DiagnosisData:
    """Return the data with the parameters `names` of the plain rig free."""
    task = data.task
    coordinates = task.model.coordinates
    shared = [name for name in dict.fromkeys(names) if name in PLAIN and name != "mu_s"]
    task = replace(
        task,
        shared=tuple(coordinates.index(name) for name in shared),
        mu_free="mu_s" in names,
        estimate_scatter=estimates_scatter,
    )
    looked_for = tuple(
        e for e in data.looked_for if not (e == RATIO and numbers_of(e)[0] in shared)
    )
    return replace(data, task=task, looked_for=looked_for)


def place_at(task: EnsembleTask, rig: Rig, mu_s: NDArray, scatter: float) -> Fits:
    """Return a plain rig, with the mu_s (n,) of its pushes, as an ensemble of one."""
    coordinates = task.model.coordinates
    c = np.zeros((1, len(coordinates.names)))
    values = parameters.values(rig)
    c[0, coordinates.indices(PLAIN)] = coordinates.point({n: float(values[n]) for n in PLAIN})
    log_mu = np.log(mu_s)
    mu = np.array([[log_mu[task.condition == k].mean() for k in range(task.conditions)]])
    own = (log_mu - mu[0, task.condition])[None]
    return Fits(((),), c, mu, own, np.array([max(scatter, _LEAST_SCATTER)]), np.ones((1, 2)))


def move_unseen(task: EnsembleTask, fits: Fits, before: Fits, some: NDArray) -> Fits:
    """The fits, which are to the pushes `some`, with the mu_s of all others moved from where it was
    `before` by as much as that of these was on average."""
    now, then = (one.mu[:, task.condition] + one.own for one in (fits, before))
    total = then + (now - then)[:, some].mean(axis=1, keepdims=True)
    total[:, some] = now[:, some]
    return replace(fits, own=total - fits.mu[:, task.condition])
