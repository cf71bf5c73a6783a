"""Fit an axis: mass, friction and offset from its recorded motion, with what stays open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from difffric.axis.breakaway import BreakawayForce, combine_breakaways, find_breakaways
from difffric.axis.friction_levels import find_levels
from difffric.axis.identifiability import find_open
from difffric.axis.noise_model import ENCODER_TIMES, KERNELS
from difffric.axis.one_thread import hold_one_thread
from difffric.axis.preparation import PreparedRecording, keep_sliding, prepare_recording
from difffric.axis.recordings import AxisRecordings
from difffric.axis.result import AxisFit, AxisNoise
from difffric.axis.search import SearchEnd, find_start, search
from difffric.axis.setup import (
    BREAKAWAY,
    COULOMB,
    MASS,
    PLAIN_NAMES,
    VISCOUS,
    AxisExtras,
    AxisSetup,
)
from difffric.errors import InputError
from difffric.progress import Tell, silent

FORCE_KERNELS = tuple(range(1 + len(ENCODER_TIMES), len(KERNELS)))
"""Which sizes of a noise are those of force disturbances."""
_MUCH = 0.05
"""Share of Coulomb friction from which on a force that is left over is told."""
_BY_CHANCE = 1e-4
"""Its probability by chance, below which it is."""
_THOUSAND = 100.0
"""Factor between the set-up's mass and the fitted one from which on a unit is in doubt."""


def fit_axis(
    setup: AxisSetup,
    data: AxisRecordings,
    *,
    free: Sequence[str] | None = None,
    tell: Tell = silent,
) -> AxisFit:
    """Fit an axis to its recording.

    `free` names the parameters to vary (`mass_kg`, `coulomb_N`, `breakaway_N`, `k_v_N_s_per_m`,
    `offset_N`, or `ID.KEY` of an effect); without it those that the set-up says, by default all
    plain ones. What the data leave open is held at the set-up's value and told.

    Raises `InputError` where the data or the names cannot be used.
    """
    tell("cutting the recording", 0.02)
    ready = prepare_recording(data, setup)
    names = choose_free(setup, free)
    with hold_one_thread():
        tell("fitting", 0.1)
        start, imposed = find_start(ready.run_data, setup.values, names)
        ready = keep_sliding(ready) if imposed else ready
        held, left_open = find_open(ready, setup, names, imposed)
        names = [x for x in names if x not in held]
        start = start | {x: setup.values[x] for x in held}
        end = search(ready.run_data, start, names, imposed)
        end, bounded = hold_in_bounds(ready, end, setup)
        tell("weighing what is left", 0.7)
        found = conclude_fit(setup, ready, end, left_open, bounded, free)
    return replace(found, notes=(*found.notes, *_tell_remainder(found)))


def _tell_remainder(fit: AxisFit) -> list[str]:
    """A note where much is left over: the law is not the axis', and errors count on it."""
    share = fit.noise.force / fit.value(COULOMB)
    p_value = fit.noise.force_p_value
    if p_value is None or p_value > _BY_CHANCE or share < _MUCH:
        return []
    return [
        f"a force of {fit.noise.force:.2g} N rms ({100 * share:.2g} % of Coulomb friction) is left "
        "over that neither the drive nor friction explains: diagnose looks for its cause"
    ]


def choose_free(setup: AxisSetup, free: Sequence[str] | None) -> list[str]:
    """Return the parameters that a fit varies, without the break-away force.

    Raises `InputError` for a name that is none.
    """
    known = setup.values
    if free is not None:
        strange = [x for x in free if x not in known]
        if strange:
            raise InputError(
                f"free: no parameter {', '.join(strange)}; an axis has {', '.join(known)}"
            )
        chosen = set(free)
    else:
        chosen = set()
        for name in known:
            said = setup.extras.get(name)
            by_default = name in PLAIN_NAMES
            if said is None or said.free is None:
                chosen |= {name} if by_default else set()
            elif said.free:
                chosen.add(name)
    return [x for x in known if x in chosen and (x != BREAKAWAY or "stribeck" in setup.effects)]


def conclude_fit(
    setup: AxisSetup,
    ready: PreparedRecording,
    end: SearchEnd,
    left_open: Sequence[dict],
    notes: Sequence[str] = (),
    free: Sequence[str] | None = None,
) -> AxisFit:
    """Return the answer of a search: errors, noise, levels and the break-away force."""
    values, noise = end.values, end.noise
    scatter = float(np.sqrt(noise.sizes[-1])) if len(ready.data) > 1 else setup.scatter or 0.0
    if noise.sizes[-1] * 1e4 < 1e-4:
        scatter = scatter if scatter > 1e-4 else 0.0
    covariance = _widen(end, scatter)
    end = replace(end, noise=replace(noise, covariance=covariance))
    levels = find_levels(ready, end)
    stuck = None
    asked = free is None or BREAKAWAY in free
    said = setup.extras.get(BREAKAWAY)
    if (
        asked
        and not end.imposed
        and BREAKAWAY not in end.names
        and (said is None or said.free is not False)
    ):
        coulomb = values[COULOMB]
        shares = [1.0 if x.coulomb is None else x.coulomb / coulomb for x in levels]
        events = find_breakaways(ready.data, ready.motions, values, shares, ready.noise)
        stuck = combine_breakaways(events, coulomb)
        if stuck is not None:
            # The mean level is known no better than that of sliding friction, and its scatter by
            # as few stretches: Student's t has a wider standard deviation.
            n = len(ready.data)
            wide = np.sqrt((n - 1) / (n - 3)) if n > 3 else np.sqrt(3.0)
            own = scatter * wide / np.sqrt(n) * stuck.value
            stuck = replace(stuck, standard_error=float(np.hypot(stuck.standard_error, own)))
    fitted = _fill_setup(setup, end, stuck, scatter)
    degrees = end.problem.n - len(end.names)
    return AxisFit(
        setup=fitted,
        names=end.names,
        covariance=covariance,
        scatter=scatter,
        scatter_error=scatter / np.sqrt(2.0 * max(len(ready.data) - 1, 1)),
        noise=_describe_noise(end),
        levels=levels,
        breakaway=stuck,
        not_identifiable=tuple(left_open),
        chi2=noise.chi2,
        degrees_of_freedom=degrees,
        criterion=noise.criterion,
        converged=end.converged,
        imposed=end.imposed,
        notes=(*ready.data.notes, *notes, *_doubt_units(setup, values)),
        data=ready.data,
        runs=ready.run_data,
    )


def _widen(end: SearchEnd, scatter: float) -> np.ndarray:
    """The covariance with the mean friction level as uncertain as the few stretches leave it: the
    scatter is known from them alone, so that Student's t takes the normal distribution's place.
    1.96 standard errors then hold 95 % of the truth."""
    covariance, stretches = end.noise.covariance.copy(), len({x.stretch for x in end.problem.rows})
    if COULOMB not in end.names or stretches < 3 or end.imposed:
        return covariance
    wider = (scipy.stats.t.ppf(0.975, stretches - 1) / scipy.stats.norm.ppf(0.975)) ** 2
    i = [*end.names].index(COULOMB)
    of_scatter = (scatter * end.values[COULOMB]) ** 2 / stretches
    covariance[i, i] += (wider - 1) * min(of_scatter, covariance[i, i])
    return covariance


def hold_in_bounds(
    ready: PreparedRecording, end: SearchEnd, setup: AxisSetup
) -> tuple[SearchEnd, list[str]]:
    """Return the search with what passed its bound held there, and a note on each: viscous friction
    below 0, and what the set-up bounds."""
    notes: list[str] = []
    for name in end.names:
        said = setup.extras.get(name, AxisExtras())
        lower = 0.0 if said.lower is None and name == VISCOUS else said.lower
        value = end.values[name]
        bound = lower if lower is not None and value < lower else None
        bound = said.upper if said.upper is not None and value > said.upper else bound
        if bound is None:
            continue
        i = [*end.names].index(name)
        error = float(np.sqrt(max(end.noise.covariance[i, i], 0.0)))
        what = "friction falls with speed: " if name == VISCOUS and bound == 0 else ""
        notes.append(
            f"{what}{name} would be {value:.3g} ± {error:.2g}; it is held at {bound:g}, and its "
            "error is not known"
        )
        names = [x for x in end.names if x != name]
        end = search(ready.run_data, end.values | {name: bound}, names, end.imposed)
    return end, notes


def _describe_noise(end: SearchEnd) -> AxisNoise:
    sizes, count = end.noise.sizes, 1 + len(ENCODER_TIMES)
    mass = 1.0 if end.imposed else end.values[MASS]
    if end.imposed:
        return AxisNoise(0.0, 0.0, float(np.sqrt(sizes[:-1].sum())), None)
    without = end.problem.fit(_drop_force(sizes), without=FORCE_KERNELS)
    drop = max(without.criterion - end.noise.criterion, 0.0)
    p_value = float(scipy.stats.chi2.sf(drop, len(FORCE_KERNELS)))
    return AxisNoise(
        float(np.sqrt(sizes[0])),
        float(np.sqrt(sizes[1:count].sum())),
        float(np.sqrt(sizes[count:-1].sum())) * mass,
        p_value,
    )


def _drop_force(sizes: np.ndarray) -> np.ndarray:
    kept = sizes.copy()
    kept[list(FORCE_KERNELS)] = 0.0
    return kept


def _fill_setup(
    setup: AxisSetup, end: SearchEnd, stuck: BreakawayForce | None, scatter: float
) -> AxisSetup:
    """The set-up with the fitted values and their standard errors."""
    errors: Mapping[str, float] = dict(
        zip(end.names, np.sqrt(np.maximum(np.diag(end.noise.covariance), 0.0)), strict=True)
    )
    fitted = {x: end.values[x] for x in end.names}
    fitted |= {x: end.values[x] for x in PLAIN_NAMES}
    extras = dict(setup.extras)
    if stuck is not None:
        fitted[BREAKAWAY] = max(stuck.value, fitted.get(COULOMB, setup.coulomb))
        errors = {**errors, BREAKAWAY: stuck.standard_error}
    elif setup.breakaway is not None:
        fitted[BREAKAWAY] = max(setup.breakaway, fitted.get(COULOMB, setup.coulomb))
    for name, error in errors.items():
        said = extras.get(name, AxisExtras())
        extras[name] = replace(said, standard_error=float(error))
    return replace(setup.replace_values(fitted), scatter=min(scatter, 0.999), extras=extras)


def _doubt_units(setup: AxisSetup, values: Mapping[str, float]) -> list[str]:
    """A note where the mass is so far from the set-up's that a unit must be wrong."""
    ratio = values[MASS] / setup.mass
    if 1 / _THOUSAND < ratio < _THOUSAND:
        return []
    guess = "position in mm that is called m, or in µm that is called mm"
    if ratio > 1:
        guess = "position in m that is called mm, or in mm that is called µm"
    return [
        f"the fitted mass is {ratio:.3g} times the set-up's: a unit may be wrong ({guess}), or the "
        "drive's gain"
    ]
