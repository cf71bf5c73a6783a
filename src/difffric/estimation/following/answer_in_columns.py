"""What an ensemble asks of a table's pushes, by plain NumPy: all pairs at once, nothing compiled.

It serves pairs whose effects can be followed in columns (`simulation.columns`); what is at its null
and is not differentiated by is left out of the rig, and costs nothing.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.compute.dual_numbers import Dual, new_level, split
from difffric.estimation.effect_coordinates import Coordinates
from difffric.rig import catalogue
from difffric.rig.catalogue import CATALOGUE
from difffric.rig.rig import Rig
from difffric.simulation.columns import observe_columns, serves

BENDING = ("stribeck", "quadratic_drag")
"""Effects for which legs are stepped through, which takes longer than the closed form."""


@lru_cache(maxsize=8)
def _list_served(rig: Rig) -> frozenset[str]:
    return frozenset(e for e in CATALOGUE if serves(catalogue.extended(rig, {e: {}})))


def list_served(rig: Rig) -> frozenset[str]:
    """The effects that can be followed in columns on top of a plain rig."""
    try:
        return _list_served(rig)
    except TypeError:  # a rig of arrays has no hash
        return _list_served.__wrapped__(rig)


def answer_in_columns(
    coordinates: Coordinates, plain: Rig, pushes: Any, c: NDArray, directions: NDArray
) -> tuple[NDArray, NDArray]:
    """What `extended_model` computes for N pairs: rows of whitened derivatives and residuals
    (N, 2, 1, D + 1), F_p and d (N, 2).

    `pushes` are theirs, c (N, K) their coordinates, directions (N, D, K) those of derivatives.
    Pairs that have to be stepped through go apart, as that takes longer than the closed form.
    """
    active = _find_active(coordinates, c, directions)
    bends = np.zeros(len(c), bool)
    for effect in BENDING:
        bends |= active.get(effect, False)
    model, by = np.empty((len(c), 2)), np.zeros((len(c), 2, directions.shape[1]))
    for which in (np.flatnonzero(~bends), np.flatnonzero(bends)):
        if len(which):
            effects = [e for e, there in active.items() if there[which].any()]
            own = coordinates, plain, pytrees.pick(pushes, which), c[which], directions[which]
            model[which], by[which] = _observe(*own, effects)
    measured, weight = pushes.data
    # Where the part never leaves the tip it slides no distance: d counts as 0.
    r = weight * (measured - np.where(np.isnan(model), 0.0, model))
    A = np.concatenate([-weight[:, :, None] * by, r[:, :, None]], axis=2)
    return A[:, :, None, :], model


def _find_active(coordinates: Coordinates, c: NDArray, directions: NDArray) -> dict[str, NDArray]:
    """Effect -> whether it is there, or is differentiated by, in each of N pairs of coordinates c
    (N, K) and directions (N, D, K); effects that are nowhere there are left out."""
    found: dict[str, NDArray] = {}
    moves = (directions != 0).any(axis=1)
    for k, name in enumerate(coordinates.names):
        effect, _, key = name.partition(".")
        if key:
            there = found.get(effect, False) | (c[:, k] != 0) | moves[:, k]
            found[effect] = there
    return {effect: there for effect, there in found.items() if there.any()}


def _observe(
    coordinates: Coordinates,
    plain: Rig,
    pushes: Any,
    c: NDArray,
    directions: NDArray,
    effects: list[str],
) -> tuple[NDArray, NDArray]:
    """F_p and d (N, 2) of the pushes, each at coordinates c (N, K), and their derivatives (N, 2, D)
    along directions (N, D, K); 0 where there is no d. `effects` are all that any of them has."""
    own = coordinates.only(effects)
    index = coordinates.indices(own.names)
    level, D = new_level(), directions.shape[1]
    columns: list[Any] = []
    for k in index:
        value, along = c[:, k], directions[:, :, k].T
        columns.append(Dual(value, along, level) if D and along.any() else _share(value))
    rig = catalogue.extended(plain, {effect: {} for effect in effects})
    given = {"mass_kg": _share(pushes.mass)}
    for name, said in (("friction_drift.share", pushes.share), ("static_dwell.rest", pushes.rest)):
        if name.partition(".")[0] in effects:
            given[name] = said
    with np.errstate(all="ignore"):  # what is no number is refused by the search
        at = own.rig(rig, columns, given, _share(pushes.stroke))
        seen = observe_columns(at, np.asarray(pushes.velocity, float))
    model, by = np.empty((len(c), 2)), np.zeros((len(c), 2, D))
    for k, y in enumerate((seen.peak_force, seen.sliding_distance)):
        value, slope = split(y, level)
        model[:, k] = value
        if slope is not None:
            by[:, k] = np.broadcast_to(slope, (D, len(c))).T
    return model, np.where(np.isfinite(model)[..., None], np.nan_to_num(by), 0.0)


def _share(column: NDArray) -> Any:
    """One number for all pairs where it is the same: it is then computed with once."""
    column = np.asarray(column, float)
    return column[0] if (column == column[0]).all() else column
