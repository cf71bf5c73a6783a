"""A predictor fitted to the exact model, the region where it holds, and the proof of its error.

For the plain rig without a stroke the error is **bounded**. Between two neighbours of a fine grid
of y = mu_s / v the exact X is monotone, so it lies between its exact values there, and the
polynomial P moves by at most L = max |P'| |X_1 - X_0|, with |P'| there from its value at the ends
and the largest |P''| of its cell: |P(X(y)) - y| is at most the larger error at the two, plus L,
plus y_1 - y_0. That d falls and F_p rises with mu_s is the model's own property; the sign of the
exact slope at every grid point confirms it. For any other rig the error is **sampled**.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.errors import InputError, NumericalError
from difffric.identification.controller.domain import Line, find_determined
from difffric.identification.controller.predictor import DETERMINED, Box, Cells, Predictor
from difffric.progress import Tell, silent
from difffric.rig import parameters
from difffric.rig.contact import UnilateralSpringDamper
from difffric.rig.friction import ViscousCoulomb
from difffric.rig.pusher import ConstantSpeed
from difffric.rig.rig import Rig
from difffric.rig.sensors import ForceSensor, Probe
from difffric.simulation.batch import observe_batch

QUANTITIES: tuple[str, ...] = ("force", "distance")
LEAST_ELASTICITY = 0.01
"""A reading that changes by less than this share of itself when mu_s doubles determines nothing."""

_MARGIN = 0.02  # of mu_s, fitted beyond the box
_XI, _LINES = 4, 5  # coefficients along X; speeds at which a range of them is fitted
_NODES = np.cos(np.pi * np.arange(12, -1, -1) / 12)
_FINE = np.linspace(-1.0, 1.0, 49)
_ROUNDS = 12
"""Times at most that cells in which a random point was off are left out and new points drawn."""
_STRIPS, _DEEPEST = 8, 4
"""Ranges of speed at first, by equal ratios, and how often one is halved where its cells lose more
than 1 % of what is determined: 128 at most, which keeps the tables of the C code small."""
_POINTS = 2000
"""Of the grid of mu_s at a speed; an eighth for a rig that is integrated, which takes long."""
_NARROWEST = 2.0**-11
"""The narrowest cell, as a share of the whole range of X (its logarithm)."""


@dataclass(frozen=True)
class Exported:
    """A predictor and what is known of its error."""

    predictor: Predictor
    homogeneous: bool
    """whether v drops out, and the error is bounded"""
    bound: dict[str, float | None]
    """by quantity, the bound of the relative error of mu_s; None: sampled only"""
    worst: dict[str, float]
    """by quantity, the worst of the independent random points"""
    answered: dict[str, float]
    """share of the box: `force`, `distance`, `either`"""
    determined: dict[str, float]
    """likewise, where the model determines mu_s, on speeds drawn at random"""
    missed: dict[str, float]
    """share of the box where the model does and the predictor does not answer"""
    points: int
    dropped: int
    """cells left out because a random point was off in them"""
    least_elasticity: float


def is_homogeneous(rig: Rig) -> bool:
    """Whether F_p / v and d / v are functions of mu_s / v alone: equations (1) and (2) as they are,
    plain sensors, and no stroke."""
    laws = (
        (rig.friction, ViscousCoulomb),
        (rig.contact, UnilateralSpringDamper),
        (rig.pusher, ConstantSpeed),
        (rig.force_sensor, ForceSensor),
        (rig.probe, Probe),
    )
    return all(type(law) is plain for law, plain in laws) and rig.pusher.stroke is None


def fit_predictor(
    rig: Rig,
    box: Box,
    *,
    max_error: float = 0.005,
    least_elasticity: float = LEAST_ELASTICITY,
    points: int | None = None,
    seed: int = 0,
    tell: Tell = silent,
) -> Exported:
    """The predictor of a rig over a box, within `max_error` (relative, of mu_s), tried on as many
    random `points` through the exact model: unless given a million, and 30 000 for a rig that is
    integrated, which takes minutes.

    Raises `InputError` for an empty box, numbers out of range and a rig without mu_s, and
    `NumericalError` where the error cannot be reached, with what was reached.
    """
    check(rig, box, max_error, least_elasticity)
    plain = is_homogeneous(rig)
    points = points or (1_000_000 if rig.affine else 30_000)
    bound: dict[str, float | None] = dict.fromkeys(QUANTITIES)
    tell("following pushes", 0.0)
    if plain:
        cells, bound = _fit_curve(rig, box, max_error, least_elasticity)
    else:
        cells = _fit_surface(rig, box, max_error, least_elasticity, tell)
    predictor = Predictor(box, max_error, **cells)
    dropped, random = 0, np.random.default_rng(seed)
    for round_ in range(1 if plain else _ROUNDS):
        tell("trying random pushes", 0.6 + 0.35 * round_ / _ROUNDS)
        worst, answered, bad = _try_points(rig, predictor, random, points)
        if plain or not any(len(cells) for cells in bad.values()):
            break
        # Readings of some other mu_s end there too: several mu_s that no line of the fit has met.
        dropped += sum(map(len, bad.values()))
        without = {name: _without(getattr(predictor, name), bad[name]) for name in QUANTITIES}
        predictor = replace(predictor, **without)
    tell("looking where there is no answer", 0.95)
    speeds = 60 if rig.affine else 20
    held, missed = _coverage(rig, predictor, random, least_elasticity, speeds)
    for name in QUANTITIES:
        reached = max(worst[name], bound[name] or 0.0)
        if reached > max_error:
            raise NumericalError(
                f"max_error: {max_error:g} of mu_s was asked for, from the {name} "
                f"{reached:.3g} was reached; allow more"
            )
    return Exported(
        predictor, plain, bound, worst, answered, held, missed, points, dropped, least_elasticity
    )


def check(rig: Rig, box: Box, max_error: float, least_elasticity: float) -> None:
    """Raise `InputError` for what `fit_predictor` cannot take; it does so itself."""
    for name, low, high in (
        ("speed [m/s]", box.slowest, box.fastest),
        ("mu_s", box.least_mu_s, box.most_mu_s),
    ):
        if not 0 < low < high < np.inf:
            raise InputError(
                f"the box is empty: {name}: expected 0 < least < most, got {low:g} to {high:g}"
            )
    if not 1e-9 <= max_error <= 0.5:
        raise InputError(f"max_error: expected a share of mu_s, 1e-9 to 0.5, got {max_error:g}")
    if not 0 < least_elasticity < 1:
        raise InputError(f"least_elasticity: expected a number in (0, 1), got {least_elasticity:g}")
    if "mu_s" not in parameters.names(rig):
        raise InputError("export: expected a rig whose friction has mu_s")


def compute_readings(rig: Rig, v: ArrayLike, mu_s: ArrayLike) -> dict[str, tuple[NDArray, NDArray]]:
    """(F_p or d, its elasticity by mu_s) of n pushes."""
    v, mu_s = np.broadcast_arrays(np.asarray(v, float), np.asarray(mu_s, float))
    seen = observe_batch(parameters.with_values(rig, {"mu_s": mu_s.copy()}), v.copy())
    with np.errstate(invalid="ignore", divide="ignore"):
        F, d = seen.peak_force, seen.sliding_distance
        return {
            "force": (F, seen.peak_force_by["mu_s"] * mu_s / F),
            "distance": (d, seen.sliding_distance_by["mu_s"] * mu_s / d),
        }


def _fit_curve(rig, box: Box, max_error, least):
    """One curve serves every speed, as v drops out."""
    ends = box.least_mu_s / box.fastest * (1 - _MARGIN), box.most_mu_s / box.slowest * (1 + _MARGIN)
    n = int(np.clip(60 * np.log(ends[1] / ends[0]) / max_error, 20_000, 2_000_000))
    y = np.geomspace(*ends, n)
    v = np.sqrt(box.slowest * box.fastest)
    seen = compute_readings(rig, v, y * v)
    speeds = np.array([box.slowest, box.fastest])
    cells, bound = {}, {}
    for name in QUANTITIES:
        q, elasticity = seen[name]
        good = find_determined(q, elasticity, y, least)
        found = _fit_cells([Line.of(y, q / v, good)], 0.8 * max_error, 1)
        cells[name] = _join_cells(speeds, [found])
        bound[name] = _bound_error(cells[name], y, q / v, good) if len(found) else 0.0
    return cells, bound


def _bound_error(cells: Cells, y, X, good) -> float:
    """The largest relative error of mu_s over all good intervals: see the head of this file."""
    mid_v = np.full(len(X), cells.speeds.mean())
    inside = np.flatnonzero(np.isfinite(X))
    cell = np.full(len(X), -1)
    cell[inside] = cells.find(mid_v[inside], X[inside])
    held = cell >= 0
    at = np.maximum(cell, 0)
    value, slope = cells.evaluate(at, mid_v, np.where(held, X, cells.lower[at]))
    error = np.where(held, np.abs(value - y), 0.0)
    j = np.arange(cells.coefficients.shape[2])
    width = cells.upper - cells.lower
    bend = 4 / width**2 * (np.abs(cells.coefficients[:, 0, :]) * j * (j - 1)).sum(axis=1)
    slope, bend = np.where(held, np.abs(slope), 0.0), np.where(held, bend[at], 0.0)
    # A good interval with an end outside all cells is that of a gap's edge: none answers beyond.
    pair = good & (held[:-1] | held[1:])
    if (np.abs(np.diff(at))[pair & held[:-1] & held[1:]] > 1).any():
        return np.inf  # a cell narrower than the grid: not covered by the argument
    worst = np.maximum(error[:-1], error[1:]) + y[1:] - y[:-1]
    apart = np.abs(np.diff(X))
    steepest = np.maximum(slope[:-1] + bend[:-1] * apart, slope[1:] + bend[1:] * apart)
    worst = worst + steepest * apart
    return float(np.max((worst / y[:-1])[pair], initial=0.0))


def _fit_surface(rig, box: Box, max_error, least, tell):
    """Ranges of speed, halved where more of what is determined would otherwise be lost."""
    edges = np.geomspace(box.slowest, box.fastest, _STRIPS + 1)
    out = {}
    todo = {name: [(a, b, 0) for a, b in pairwise(edges)] for name in QUANTITIES}
    lines: dict[tuple[float, float], dict[str, list[Line]]] = {}
    for k, name in enumerate(QUANTITIES):
        done = []
        while todo[name]:
            a, b, depth = todo[name].pop()
            tell("following pushes", 0.3 * k + 0.3 * len(done) / (len(done) + len(todo[name]) + 1))
            if (a, b) not in lines:
                lines[a, b] = _trace_lines(rig, a, b, box, least)
            own = lines[a, b][name]
            found = _fit_cells(own, 0.6 * max_error, 3)
            lost = _measure_loss(own, found)
            if lost > 0.01 and depth < (_DEEPEST if rig.affine else _DEEPEST - 1):
                middle = float(np.sqrt(a * b))
                todo[name] += [(a, middle, depth + 1), (middle, b, depth + 1)]
            else:
                done.append((a, b, found))
        done.sort(key=lambda strip: strip[0])
        out[name] = _join_cells(
            np.array([*(a for a, _, _ in done), box.fastest]), [f for *_, f in done]
        )
    return out


def _trace_lines(rig, a, b, box: Box, least) -> dict[str, list[Line]]:
    """At the fitted speeds of a range."""
    v = 0.5 * (a + b) + 0.5 * (b - a) * np.linspace(-1, 1, _LINES)
    n = _POINTS if rig.affine else _POINTS // 8
    y = np.geomspace(box.least_mu_s / b * (1 - _MARGIN), box.most_mu_s / a * (1 + _MARGIN), n)
    seen = compute_readings(rig, np.repeat(v, len(y)), (v[:, None] * y).ravel())
    out = {}
    for name in QUANTITIES:
        q, elasticity = (column.reshape(len(v), -1) for column in seen[name])
        out[name] = [
            Line.of(y, q[i] / v[i], find_determined(q[i], elasticity[i], y, least))
            for i in range(len(v))
        ]
    return out


def _fit_cells(lines: list[Line], within: float, tau: int) -> list[tuple[float, float, NDArray]]:
    """Cells (lower, upper, coefficients) that hold the inverse within an error, wherever it is
    determined at every speed of `lines`; halved until they do."""
    ends = [line.X for line in lines if len(line.X)]
    if not ends:
        return []
    lower, upper = min(x[0] for x in ends), max(x[-1] for x in ends)
    nodes_v = np.linspace(-1, 1, len(lines)) if tau > 1 else np.zeros(1)
    by_v = np.linalg.pinv(np.vander(nodes_v, tau, increasing=True))
    by_X = np.linalg.pinv(np.vander(_NODES, _XI, increasing=True)).T
    fine = np.vander(_FINE, _XI, increasing=True).T
    back = np.vander(nodes_v, tau, increasing=True)
    narrowest = _NARROWEST * np.log(upper / lower)
    todo, found = [(lower, upper)], []
    while todo:
        a, b = todo.pop()
        covered = [line.measure_cover(a, b) for line in lines]
        if max(covered) <= 1e-9:
            continue
        if min(covered) >= 1 - 1e-6:
            middle, half = 0.5 * (a + b), 0.5 * (b - a)
            Y = np.stack([np.interp(middle + half * _NODES, x.X, x.y) for x in lines])
            c = by_v @ Y @ by_X
            exact = np.stack([np.interp(middle + half * _FINE, x.X, x.y) for x in lines])
            if (np.abs(back @ c @ fine - exact) <= within * exact).all():
                found.append((a, b, c))
                continue
        if np.log(b / a) > narrowest:
            middle = float(np.sqrt(a * b))
            todo += [(middle, b), (a, middle)]
    return found


def _measure_loss(lines: list[Line], found) -> float:
    """The share of y (by its logarithm) that is determined and in no cell."""
    lower = np.array([a for a, _, _ in found])
    upper = np.array([b for _, b, _ in found])
    total = lost = 0.0
    for line in lines:
        X = 0.5 * (line.X[::2] + line.X[1::2])
        size = np.abs(np.log(line.y[1::2] / line.y[::2]))
        at = np.searchsorted(lower, X, "right") - 1
        inside = (at >= 0) & (X <= upper[at]) if len(lower) else np.zeros(len(X), bool)
        total, lost = total + size.sum(), lost + size[~inside].sum()
    return lost / total if total else 0.0


def _join_cells(speeds, strips) -> Cells:
    counts = np.cumsum([0, *(len(found) for found in strips)])
    every = [cell for found in strips for cell in found]
    shape = next((c.shape for _, _, c in every), (1, _XI))
    return Cells(
        speeds=np.asarray(speeds, float),
        first=counts,
        lower=np.array([a for a, _, _ in every] or [1.0]),
        upper=np.array([b for _, b, _ in every] or [2.0]),
        coefficients=np.array([c for *_, c in every]) if every else np.zeros((1, *shape)),
    )


def draw_points(random: np.random.Generator, box: Box, n: int) -> tuple[NDArray, NDArray]:
    """n random (speed [m/s], mu_s) of a box, evenly."""
    v = random.uniform(box.slowest, box.fastest, n)
    return v, random.uniform(box.least_mu_s, box.most_mu_s, n)


def _errors(rig, predictor: Predictor, v, mu_s):
    """By quantity, (relative error of mu_s, whether it was answered), with the readings."""
    seen = compute_readings(rig, v, mu_s)
    F, d = seen["force"][0], seen["distance"][0]
    found = predictor.predict(v, F, d)
    return {
        "force": (np.abs(found.mu_s_force / mu_s - 1), found.force == DETERMINED, F),
        "distance": (np.abs(found.mu_s_distance / mu_s - 1), found.distance == DETERMINED, d),
    }


def _without(cells: Cells, bad) -> Cells:
    keep = np.ones(cells.first[-1], bool)
    keep[bad] = False
    if not keep.any():
        return _join_cells(cells.speeds, [[] for _ in cells.speeds[1:]])
    before = np.concatenate([[0], np.cumsum(keep)])
    return Cells(
        cells.speeds, before[cells.first], cells.lower[keep], cells.upper[keep],
        cells.coefficients[keep],
    )  # fmt: skip


def _try_points(rig, predictor: Predictor, random, points):
    """(worst error by quantity, share answered, cells in which the error is too large), of random
    points."""
    worst = dict.fromkeys(QUANTITIES, 0.0)
    answered = dict.fromkeys([*QUANTITIES, "either"], 0)
    bad = {name: np.zeros(0, int) for name in QUANTITIES}
    for start in range(0, points, 250_000):
        n = min(250_000, points - start)
        v, mu_s = draw_points(random, predictor.box, n)
        found = _errors(rig, predictor, v, mu_s)
        for name in QUANTITIES:
            error, has, q = found[name]
            worst[name] = max(worst[name], float(np.max(error[has], initial=0.0)))
            answered[name] += int(has.sum())
            off = has & (error > predictor.max_error)
            cells: Cells = getattr(predictor, name)
            bad[name] = np.union1d(bad[name], cells.find(v[off], q[off] / v[off])).astype(int)
        answered["either"] += int((found["force"][1] | found["distance"][1]).sum())
    return worst, {name: count / points for name, count in answered.items()}, bad


def _coverage(rig, predictor: Predictor, random, least, speeds, points=1000):
    """(share of the box that the model determines, share of it that the predictor leaves out)."""
    box = predictor.box
    mu_s = np.linspace(box.least_mu_s, box.most_mu_s, points)
    held = dict.fromkeys([*QUANTITIES, "either"], 0.0)
    missed = dict(held)
    share = (np.arange(speeds) + random.random(speeds)) / speeds
    for v in box.slowest + (box.fastest - box.slowest) * share:
        seen = compute_readings(rig, v, mu_s)
        found = predictor.predict(v, seen["force"][0], seen["distance"][0])
        can, does = [], []
        for name, code in (("force", found.force), ("distance", found.distance)):
            good = find_determined(*seen[name], mu_s, least)
            can.append(good)
            does.append((code[:-1] == DETERMINED) & (code[1:] == DETERMINED))
        can.append(can[0] | can[1])
        does.append(does[0] | does[1])
        for name, c, d in zip(held, can, does, strict=True):
            held[name] += float(c.mean()) / speeds
            missed[name] += float((c & ~d).mean()) / speeds
    return held, missed
