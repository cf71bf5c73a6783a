"""The model of one push over mu_s, solved beforehand on a grid: mu_s from F_p and d at once.

`invert` looks for the crossings anew for each push, which takes longer than a push may. Here the
grid tells in which cell they are. `TabulatedModel.invert` answers for one push with every root;
`TabulatedModel.find_roots` for many pushes at a setting with the one root that is meant.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from difffric.compute.xla_options import compile_soon
from difffric.identification.compiled_models import observe_at
from difffric.identification.crossing import find_crossing
from difffric.identification.inversion import BRACKET, Inversion, Root, judge_roots
from difffric.identification.push_models import QUANTITIES, Quantity
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.batch import observe_batch
from difffric.simulation.segments import Integrator

_POINTS = 1024
"""Of the grid: 0.7 % of mu_s from one to the next, so that Newton's iteration starts close."""
_CHUNK = 512
"""Points solved at once: always so many, so that one program is compiled."""
_MOST = 8
"""Crossings that are solved: always so many, so that one program is compiled."""
_NEWTON = 6
"""Newton steps from a cell of the grid, which is so narrow that three do."""
_CLOSE = 1e-6
"""How close F_p or d must be before Newton's last step, relative: it squares it; more is a jump of
the model."""
_BRANCH = (0.2, 0.05)
"""Distances of the branches of the model from each other, of mu_s and of F_p."""


@dataclass(frozen=True)
class TabulatedModel:
    """F_p [N] and d [m] of a push over mu_s, on a grid of it."""

    rig: Rig
    """each number a NumPy array ()"""
    velocity: float
    integrator: Integrator | None
    mu_s: Float[NDArray, " n"]
    both: Float[NDArray, "2 n"]
    """NaN where a push has none"""

    @classmethod
    def of(cls, rig: Rig, velocity: float, integrator: Integrator | None = None) -> TabulatedModel:
        """The table of one push at a speed [m/s]."""
        own = jax.tree.map(lambda leaf: np.asarray(leaf, float), rig)
        mu_s = np.geomspace(*BRACKET, _POINTS)
        both = _observe_many(own, np.full(_POINTS, velocity), mu_s, integrator)
        return cls(own, velocity, integrator, mu_s, both)

    def at(self, mu_s: float) -> tuple[float, float]:
        """(F_p, d) at the grid's point next to this mu_s."""
        F, d = self.both[:, int(np.searchsorted(self.mu_s, mu_s))]
        return float(F), float(d)

    def invert(self, target: float, quantity: Quantity) -> Inversion:
        """mu_s from the measured quantity [N or m], NaN: not measured. As `invert`, but for two
        crossings closer to each other than 0.7 % of mu_s."""
        by_force = quantity == "peak_force"
        value = self.both[QUANTITIES.index(quantity)]
        if not np.isfinite(target):
            name = "peak force" if by_force else "sliding distance"
            return Inversion(None, reason=f"no {name} was measured")
        below = value < target
        exists = np.isfinite(value)
        # An end on a jump of the model is a crossing too, which the solver then finds to be none.
        at = np.flatnonzero((below[1:] != below[:-1]) & (exists[1:] | exists[:-1]))[:_MOST]
        roots = self._solve(target, by_force, at, below[at]) if len(at) else []
        least = np.nanmin(value) if exists.any() else np.nan
        most = np.nanmax(value) if exists.any() else np.nan
        return judge_roots(roots, target, quantity, BRACKET, (least, most))

    def _solve(self, target: float, by_force: bool, at: NDArray, rising: NDArray) -> list[Root]:
        """The crossings in these cells of the grid."""
        cells = np.resize(at, _MOST)
        brackets = np.stack([self.mu_s[cells], self.mu_s[cells + 1]], axis=1)
        given = (np.asarray(x) for x in (self.velocity, float(target), by_force))
        found = _solve_cells(self.rig, *given, brackets, np.resize(rising, _MOST), self.integrator)
        solved = zip(*(np.asarray(x)[: len(at)] for x in found), strict=True)
        return [(float(mu_s), float(slope)) for mu_s, slope, good in solved if good]

    def choose_by_force(self, distance: Inversion, peak_force: float) -> Inversion:
        """Among several mu_s for one distance, the one that the measured force [N] supports."""
        if not distance.alternatives or np.isnan(peak_force):
            return distance
        force = np.interp(distance.alternatives, self.mu_s, self.both[0])
        return distance.at(int(np.argmin(np.abs(force - peak_force))))

    def find_roots(
        self,
        target: Float[NDArray, " n"],
        quantity: Quantity,
        expected: float,
        force: Float[NDArray, " n"] | None = None,
    ) -> Float[NDArray, " n"]:
        """log mu_s of n pushes at which the model gives the measured quantity [N or m]; NaN: at
        none. Of several, the one nearest to what is `expected` (log mu_s) and, where it is given,
        to the measured force [N].

        Newton's steps are its own: they go through `observe_batch`, all pushes at once on all
        cores; the bracketed iteration of `crossing` would end in other last digits.
        """
        which = QUANTITIES.index(quantity)
        grid, value = np.log(self.mu_s), self.both[which]
        exists = np.isfinite(value)
        below = value < target[:, None]
        crosses = (below[:, 1:] != below[:, :-1]) & exists[1:] & exists[:-1]
        away = ((grid[1:] - expected) / _BRANCH[0]) ** 2 * np.ones(crosses.shape)
        if force is not None:
            F = 0.5 * (self.both[0][1:] + self.both[0][:-1])
            off = ((F / force[:, None] - 1.0) / _BRANCH[1]) ** 2
            away = away + np.where(np.isnan(off), 0.0, off)
        cell = np.argmin(np.where(crosses, away, np.inf), axis=1)
        some = crosses[np.arange(len(target)), cell]
        low, high = grid[cell], grid[cell + 1]
        x = np.where(some, 0.5 * (low + high), np.nan)
        close = np.zeros(len(target), bool)
        for _ in range(_NEWTON):
            seen, slope = self.observe(x)
            with np.errstate(divide="ignore", invalid="ignore"):
                off = seen[which] - target
                close = np.abs(off) < _CLOSE * target
                x = np.clip(x - off / slope[which], low, high)
            if (close | ~some).all():
                break
        return np.where(some & close, x, np.nan)

    def observe(
        self, log_mu_s: Float[NDArray, " n"]
    ) -> tuple[Float[NDArray, "2 n"], Float[NDArray, "2 n"]]:
        """F_p and d at log mu_s, and their derivatives by it; NaN at NaN. Exact, not from the
        grid."""
        known = np.isfinite(log_mu_s)
        mu_s = np.exp(np.where(known, log_mu_s, -2.0))
        rig = parameters.with_values(self.rig, {"mu_s": mu_s})
        seen = observe_batch(rig, self.velocity, derivatives=("mu_s",))
        model = np.stack([seen.peak_force, seen.sliding_distance])
        slope = np.stack([seen.peak_force_by["mu_s"], seen.sliding_distance_by["mu_s"]])
        return np.where(known, model, np.nan), np.where(known, slope * np.exp(log_mu_s), np.nan)


def compute_range_ratio(
    rig: Rig, velocity: NDArray, mu_s: NDArray, integrator: Integrator | None = None
) -> float:
    """Delta F / Delta d of equation (7) [N/m] over the grid of speeds [m/s] and mu_s, by the
    program that tabulates, which is compiled for a table anyway."""
    v, mu = (x.ravel() for x in np.meshgrid(velocity, mu_s, indexing="ij"))
    own = jax.tree.map(lambda leaf: np.asarray(leaf, float), rig)
    F, d = _observe_many(own, v, mu, integrator)
    return float(np.ptp(F) / (np.nanmax(d) - np.nanmin(d)))


def _observe_many(
    rig: Rig, velocity: NDArray, mu_s: NDArray, integrator: Integrator | None
) -> Float[NDArray, "2 n"]:
    """F_p and d of one rig at n speeds and mu_s."""
    found = []
    for lo in range(0, len(mu_s), _CHUNK):
        at = np.minimum(np.arange(lo, lo + _CHUNK), len(mu_s) - 1)
        found.append(np.stack(_observe_chunk(rig, velocity[at], mu_s[at], integrator)))
    return np.concatenate(found, axis=1)[:, : len(mu_s)]


@compile_soon
def _observe_chunk(
    rig: Rig, velocity: Float[Array, " n"], mu_s: Float[Array, " n"], integrator: Integrator | None
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    def observe_one(velocity, mu_s):
        seen = observe_at(rig, velocity, mu_s, integrator)
        return seen.peak_force, seen.sliding_distance

    return jax.vmap(observe_one)(velocity, mu_s)


@compile_soon
def _solve_cells(rig, velocity, target, by_force, brackets, rising, integrator):
    def solve_one(bracket, rising):
        return find_crossing(rig, velocity, target, by_force, bracket, rising, integrator)

    return jax.vmap(solve_one)(brackets, rising)
