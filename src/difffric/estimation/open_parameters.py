"""Which free parameters their covariance leaves open, and how they trade off, in words.

A parameter counts as determined where its standard error is below a stated unit of its own: a
factor e, or, for k_v, a quarter of the sliding friction at the fastest speed. Whether zero lies
within an error bar is another matter: a k_v of 1 +- 2 N s/m moves no prediction by much.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.coordinates import to_coordinate
from difffric.estimation.push_rigs import make_push_rigs
from difffric.measurements.pushes import Pushes
from difffric.number_text import format_number
from difffric.rig import parameters
from difffric.rig.parameters import PARAMETERS
from difffric.rig.rig import Rig
from difffric.simulation.columns import observe_columns, serves
from difffric.units import to_mm_min

SHARE = 0.25
"""k_v is open where one standard error of k_v v exceeds this share of the sliding friction."""
UNSEEN = 1e4
"""A standard error of this many units says that the data see nothing of a parameter."""
_PART = 0.05
"""What moves by less than this many units, for one of the first, is left out of the words."""

_K_V = "k_v_N_s_per_m"
_RATIO = "mu_k_over_mu_s"
_OTHER = 1.001
"""By how much mu_s is changed, mu_k staying, to see whether anything measured depends on it."""
_SAME = 1e-9
"""Relative change of F_p and d that is rounding."""


def open_units(rig: Rig, names: Sequence[str], fastest: float) -> NDArray:
    """The standard error (free,), in coordinates, from which each parameter counts as open.

    1 of a logarithm; for k_v what makes `SHARE` of the friction `mu_k F_N + k_v v` at the
    fastest speed [m/s]. `rig` holds scalars.
    """
    out = np.ones(len(names))
    known = {name: float(value) for name, value in parameters.values(rig).items()}
    if _K_V in names and {"mu_s", "mu_k_over_mu_s"} <= set(known) and fastest > 0:
        friction = known["mu_s"] * known["mu_k_over_mu_s"] * float(rig.F_N)
        friction += known[_K_V] * fastest
        open_from = float(to_coordinate(_K_V, SHARE * friction / fastest))
        out[[name == _K_V for name in names]] = open_from
    return out


def describe_assumed_ratio(
    rig: Rig, pushes: Pushes, mu_s: NDArray | None = None
) -> tuple[str, ...]:
    """Say that these n pushes tell mu_k alone, where they do, so that mu_s rests on the ratio of
    both that the rig holds; else nothing, also of a rig that cannot be followed in columns.

    `mu_s` (n,) is that of each push, and NaN where only the rig says it.
    """
    at_all = (
        rig if mu_s is None else parameters.with_values(rig, {"mu_s": _find_typical(rig, mu_s)})
    )
    ratio = (
        f"mu_s = mu_k / {float(parameters.values(rig)[_RATIO]):.4g} uses the ratio of the set-up"
    )
    if pushes.free_slides:
        return (f"free slides tell mu_k alone; {ratio}",)
    rigs = make_push_rigs(rig, pushes)
    if mu_s is not None:
        own = np.where(np.isnan(mu_s), parameters.values(rigs)["mu_s"], mu_s)
        rigs = parameters.with_values(rigs, {"mu_s": own})
    if not serves(rigs):
        return ()
    known = parameters.values(rigs)
    other = {"mu_s": _OTHER * known["mu_s"], _RATIO: known[_RATIO] / _OTHER}
    seen = observe_columns(rigs, pushes.velocity)
    moved = observe_columns(parameters.with_values(rigs, other), pushes.velocity)
    for name in ("peak_force", "sliding_distance"):
        pair = getattr(seen, name), getattr(moved, name)
        if not np.allclose(*pair, rtol=_SAME, atol=0.0, equal_nan=True):
            return ()
    below = format_number(to_mm_min(find_sticking_speed(at_all)), 2)
    return (
        f"no push sticks before it slides, so these data tell mu_k alone; {ratio}. A push slower "
        f"than about {below} mm/min would tell mu_s itself",
    )


def _find_typical(rig: Rig, mu_s: NDArray) -> float:
    """Return the median of the pushes' mu_s, or the rig's own where none is known."""
    known = mu_s[np.isfinite(mu_s)]
    return float(np.median(known)) if len(known) else float(parameters.values(rig)["mu_s"])


def find_sticking_speed(rig: Rig) -> float:
    """Return the speed [m/s] below which a push sticks before it slides: up to there the damper's
    force at first touch, b v, does not reach mu_s F_N."""
    return float(rig.friction.breakaway(rig.F_N) / rig.contact.approach(0.0, 1.0))


def list_undetermined(
    labels: Sequence[str], names: Sequence[str], covariance: NDArray, unit: NDArray
) -> list[dict]:
    """The parameters that the data leave open, in groups: `parameters` (labels) and `reason`.

    `covariance` (free, free) is that of the coordinates; a variance of 0 says that the data do
    not depend on the parameter at all. `unit` (free,) is from `units`. A parameter is flat where
    it would stay open with all others known; else it is traded off, and the sloppy direction
    (an eigenvector of the covariance in these units) says against what.
    """
    scale = np.asarray(unit, float)
    C = np.asarray(covariance, float) / np.outer(scale, scale)
    error = np.sqrt(np.diag(C))
    out = []
    for j in np.flatnonzero(error == 0).tolist():
        out.append(_make_entry([labels[j]], "flat: the data do not depend on it"))
    seen = np.flatnonzero(error > 0).tolist()
    left = [j for j in seen if error[j] >= 1]
    alone = _compute_errors_alone(C[np.ix_(seen, seen)])
    for j, own in zip(seen, alone, strict=True):
        if j in left and own >= 1:
            left.remove(j)
            out.append(_make_entry([labels[j]], _tell_flat(names[j], own, scale[j])))
    if not left:
        return out
    values, vectors = np.linalg.eigh(C[np.ix_(left, left)])
    wide = max(int((values >= 1).sum()), 1)
    pivots, directions = _sparsify(vectors[:, -wide:])
    covered: set[int] = set()
    for p, direction in zip(pivots, directions.T, strict=True):
        first = left[p]
        members = [first] + [
            left[i]
            for i in np.argsort(-np.abs(direction)).tolist()
            if i != p and abs(direction[i]) * error[first] >= 1 and abs(direction[i]) > _PART
        ]
        # What the open ones take along, though it is determined itself.
        along = [j for j in seen if j not in left]
        moves = {left[i]: w for i, w in enumerate(direction.tolist())}
        moves |= {j: float(C[j, first] / C[first, first]) for j in along}
        covered |= set(members)
        out.append(
            _make_entry(
                [labels[j] for j in members], _tell_trade(first, moves, labels, names, scale)
            )
        )
    for j in left:
        if j not in covered:
            first = left[int(np.argmax(np.abs(C[j, left]) * (np.array(left) != j)))]
            moves = {j: 1.0, first: float(C[first, j] / C[j, j])}
            out.append(_make_entry([labels[j]], _tell_trade(j, moves, labels, names, scale)))
    return out


def _make_entry(parameters: list[str], reason: str) -> dict:
    """A group of parameters with its reason, as `result.json` has it."""
    return {"parameters": parameters, "reason": reason}


def _compute_errors_alone(C: NDArray) -> NDArray:
    """The standard error of each parameter with all others known, from their covariance C: the
    inverse covariance's diagonal."""
    size = np.sqrt(np.diag(C))
    values, vectors = np.linalg.eigh(C / np.outer(size, size))
    information = (vectors**2 / np.maximum(values, 1e-15)).sum(axis=1) / size**2
    return 1 / np.sqrt(information)


def _sparsify(V: NDArray) -> tuple[list[int], NDArray]:
    """Pivots, and vectors (left, wide) that span the same space as V's columns, each 1 at its own
    pivot and 0 at the others', so that what is open by itself does not mix with the rest."""
    rest, pivots = V.copy(), []
    for _ in range(V.shape[1]):
        p = int(np.argmax((rest**2).sum(axis=1)))
        pivots.append(p)
        axis = rest[p] / np.linalg.norm(rest[p])
        rest = rest - np.outer(rest @ axis, axis)
    return pivots, V @ np.linalg.inv(V[pivots])


def _tell_flat(name: str, own: float, unit: float) -> str:
    """The reason of a parameter that stays open with all others known: its standard error is `own`
    times `unit`, in coordinates."""
    if own >= UNSEEN:
        return "flat: the data do not depend on it"
    said = "one standard error, with all others known, is"
    row = PARAMETERS[name]
    if row.step is not None:
        return f"flat: {said} {own * unit * row.step:.3g} {row.unit}".rstrip()
    return f"flat: {said} a factor of {np.exp(min(own * unit, 50.0)):.3g}"


def _tell_trade(
    first: int,
    moves: dict[int, float],
    labels: Sequence[str],
    names: Sequence[str],
    scale: NDArray,
) -> str:
    """The direction along which the data say nothing, in words: how far each parameter moves, in
    units of its `scale` (free,), for a small step of the first."""
    steps = {j: w * scale[j] / scale[first] for j, w in moves.items()}
    shown = [j for j in steps if j != first and abs(moves[j]) > _PART]
    shown.sort(key=lambda j: -abs(moves[j]))
    own = PARAMETERS[names[first]].step
    base = 0.01 if own is None else 1.0 / own

    def tell_step(j: int, x: float) -> str:
        size = abs(x) * base
        how = "up" if x > 0 else "down"
        row = PARAMETERS[names[j]]
        if row.step is None:
            return f"{labels[j]} {how} {100 * size:.2g} %"
        return f"{labels[j]} {how} {size * row.step:.2g} {row.unit}".rstrip()

    if not shown:
        return f"these data hardly see {tell_step(first, 1.0)}"
    with_ = " and ".join(tell_step(j, steps[j]) for j in shown)
    others = ", ".join(labels[j] for j in shown)
    return (
        f"traded off against {others}: these data hardly see {tell_step(first, 1.0)} with {with_}"
    )
