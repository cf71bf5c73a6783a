"""What the equation of motion leaves over in each run, twice integrated, and its derivatives.

    e = m (x - x_0 - u_0 t) - int int (force + offset - friction) dt dt

Integrated instead of differentiated, the positions' noise is not amplified, and the recorded force,
which is known exactly, keeps its place. Each run's start x_0, u_0 is free and eliminated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from difffric.axis.effects import EFFECTS, Point, list_effect_keys
from difffric.axis.noise_model import RunRows, make_force_rows, make_rows
from difffric.axis.one_sign_runs import MeasuredMotion, OneSignRun
from difffric.axis.recordings import AxisStretch
from difffric.axis.setup import BREAKAWAY, COULOMB, MASS, OFFSET, PLAIN_NAMES, VISCOUS

MOST_BLOCKS = 120
"""Blocks of a run at most: the cost of its covariance grows with their cube."""
_ALL_BLOCKS = 4000
"""Blocks of all runs at most."""
_FINEST = 0.004
"""Seconds of a block at least."""


@dataclass(frozen=True)
class RunData:
    """One run, ready for the equation of motion."""

    run: OneSignRun
    begin: float
    """time of its first sample [s]"""
    edges: NDArray
    """(blocks,) first sample of each block, within the run"""
    per_block: int
    tau: NDArray
    """(n,) time since the run's first sample [s]"""
    hold: NDArray
    """(n,) how long the force of each sample is held [s]"""
    force: NDArray
    """(n,) [N]"""
    late: Callable[[float], tuple[NDArray, NDArray]]
    """delay [s] -> the force as it acts that much later (n,), integrated twice and once"""
    x: NDArray
    """(n,) position less that at the run's first sample [m]"""
    smooth_force: NDArray
    """(n,) the force, smoothed as the acceleration is, for a person to look at [N]"""
    acceleration: NDArray
    """(n,) slope of the speed [m/s²], for a motion that is imposed"""
    point: Point
    """where the axis is and how fast, at each sample"""


def prepare_run(
    run: OneSignRun, stretch: AxisStretch, motion: MeasuredMotion, block_time: float, order: float
) -> RunData:
    """Return a run with its blocks, of `block_time` [s] or longer; `order` is the stretch's place
    among all, from -1/2 to 1/2."""
    part = run.samples
    t = stretch.time[part]
    n, duration = len(t), t[-1] - t[0]
    step = duration / (n - 1)
    size = max(1, int(np.ceil(n / MOST_BLOCKS)), round(block_time / step))
    size = min(size, max(1, n // 12))
    edges = np.arange(0, n - size + 1, size)
    used = edges[-1] + size
    tau = t[:used] - t[0]
    hold = np.diff(t[: used + 1]) if used < n else np.append(np.diff(t[:used]), step)
    force = stretch.force[part][:used]
    point = Point(
        stretch.position[part][:used],
        run.sign * np.maximum(run.sign * motion.speed[part][:used], 0.0),
        run.sign,
        order,
    )
    late = partial(_delay_force, stretch, t[:used])
    x = point.position - point.position[0]
    smooth = motion.force[part][:used]
    acceleration = np.gradient(motion.speed, stretch.time)[part][:used]
    return RunData(
        run, float(t[0]), edges, size, tau, hold, force, late, x, smooth, acceleration, point
    )


def choose_block_time(runs: Sequence[OneSignRun], stretches: Sequence[AxisStretch]) -> float:
    """Return how long blocks are to be, so that there are not too many [s]."""
    total = sum(stretches[r.stretch].time[r.last - 1] - stretches[r.stretch].time[r.first]
                for r in runs)  # fmt: skip
    return max(_FINEST, total / _ALL_BLOCKS)


@dataclass(frozen=True)
class RunResiduals:
    """What is left over in all runs, and its derivatives, in rows without the free starts."""

    errors: list[NDArray]
    """(rows,) a run: the equation's error, twice integrated [N s²]"""
    slopes: list[NDArray]
    """(rows, parameters) a run"""
    levels: list[NDArray]
    """(rows,) a run: derivative by a relative change of the friction level"""


class MotionModel:
    """The equation of motion over all runs, for chosen parameters.

    `names` are plain parameters (`mass_kg`) and keys of effects (`cogging.amplitude_N`).
    """

    def __init__(self, runs: Sequence[RunData], rate: float = 0.0, imposed: bool = False):
        """`rate` [1/s] is k_v / m, by which the axis forgets its speed: the rows are what is left
        over in its position. At 0 they are twice integrated forces. Where the motion is `imposed`
        on the axis, and the force is what answers, they are forces as they are."""
        self.runs: Sequence[RunData] = runs
        self.rate, self.imposed = rate, imposed
        self.rows = [self._make_rows(run) for run in runs]
        self._fixed = [self._integrate_plain(k) for k in range(len(runs))]

    @property
    def duration(self) -> float:
        """How long all runs last together [s]."""
        return float(sum(run.tau[-1] for run in self.runs))

    def select(self, chosen: Sequence[int]) -> MotionModel:
        """Return the same model of some of the runs only."""
        part = object.__new__(MotionModel)
        part.runs = [self.runs[i] for i in chosen]
        part.rate, part.imposed = self.rate, self.imposed
        part.rows = [self.rows[i] for i in chosen]
        part._fixed = [self._fixed[i] for i in chosen]
        return part

    def evaluate(self, values: Mapping[str, float], names: Sequence[str]) -> RunResiduals:
        """Return what is left over at these values of all parameters, and the derivatives by the
        named ones."""
        effects = {name.partition(".")[0] for name in values if "." in name}
        errors, slopes, levels = [], [], []
        for k, (run, (X, A, B, V)) in enumerate(zip(self.runs, self._fixed, strict=True)):
            s = run.run.sign
            columns = {MASS: X, COULOMB: s * B, VISCOUS: V, OFFSET: -B}
            error = sum(values[name] * columns[name] for name in PLAIN_NAMES) - A
            for effect in [x for x in EFFECTS if x in effects]:
                shape = self._respond(k, effect, values)
                error = error + shape[0]
                for key, column in zip(list_effect_keys(effect), shape[1:], strict=True):
                    columns[key] = column
                self._add_plain_slopes(k, effect, values, columns)
            errors.append(np.asarray(error))
            slopes.append(np.column_stack([columns[name] for name in names]))
            # All that is of the kind of Coulomb friction goes with the stretch's level.
            level = values[COULOMB] * columns[COULOMB]
            if BREAKAWAY in columns:
                level = level + values[BREAKAWAY] * columns[BREAKAWAY]
            levels.append(level)
        return RunResiduals(errors, slopes, levels)

    def _make_rows(self, run: RunData) -> RunRows:
        if self.imposed:
            return make_force_rows(run.run.stretch, self._average(run, run.tau), run.per_block)
        starts = [self._average(run, x) for x in (np.ones(len(run.tau)), run.tau)]
        means = np.add.reduceat(run.tau, run.edges) / run.per_block
        size = float(run.per_block)
        return make_rows(run.run.stretch, means, np.column_stack(starts), size, self.rate)

    def _integrate_plain(self, k: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Rows of position, of the twice integrated force and unit force, and of the path."""
        run = self.runs[k]
        if self.imposed:
            plain = (run.acceleration, run.force, np.ones(len(run.tau)), run.point.speed)
            x, force, unit, path = (self._reduce(k, one) for one in plain)
            return x, force, unit, path
        # Between two samples x is nearly a parabola: trapezia and the ends' slopes are exact then.
        curved = np.mean(np.diff(run.tau) ** 2) / 12 * (run.point.speed - run.point.speed[0])
        path = integrate_smooth(run.x, run.tau) - curved
        held = integrate_held(run.force, run.hold)
        x, force, unit, path = (self._reduce(k, x) for x in (run.x, held, run.tau**2 / 2, path))
        return x, force, unit, path

    def _average(self, run: RunData, samples: NDArray) -> NDArray:
        """Block means of samples (n,) or (n, columns), of which the axis forgets its speed."""
        if self.rate:
            half = self.rate * run.tau[-1] / (len(run.tau) - 1) / 2
            top, bottom = np.array([1.0, -1.0]), np.array([1.0 + half, half - 1.0])
            begin = samples[:1] * (1 - 1 / (1 + half))
            filtered = lfilter(top / bottom[0], bottom / bottom[0], samples, axis=0, zi=begin)
            samples = filtered[0]
        return np.add.reduceat(samples, run.edges) / run.per_block

    def _reduce(self, k: int, samples: NDArray) -> NDArray:
        """Rows of a run for samples (n,) or (n, columns): block means, without start and speed."""
        return self.rows[k].keep.T @ self._average(self.runs[k], samples)

    def _respond(self, k: int, effect: str, values: Mapping[str, float]) -> list[NDArray]:
        """Rows of what an effect adds to the resistance, then of its derivatives by its keys."""
        run, law = self.runs[k], EFFECTS[effect].law
        sizes = [values[key] for key in list_effect_keys(effect)]
        if EFFECTS[effect].delays:
            if self.imposed:
                return [np.zeros_like(self._fixed[k][0])] * 2
            (now, _), (then, once) = run.late(0.0), run.late(sizes[0])
            return [self._reduce(k, now - then), self._reduce(k, once)]
        resisting = law.resist(run.point, values, *sizes)
        slopes = law.differentiate(run.point, values, *sizes)
        return [self._twice(k, x) for x in (resisting, *slopes)]

    def _add_plain_slopes(
        self, k: int, effect: str, values: Mapping[str, float], columns: dict[str, NDArray]
    ) -> None:
        """Add to the plain parameters' columns what they change of an effect."""
        if EFFECTS[effect].delays:
            return
        sizes = [values[key] for key in list_effect_keys(effect)]
        by_plain = EFFECTS[effect].law.differentiate_plain(self.runs[k].point, values, *sizes)
        for name, slope in by_plain.items():
            columns[name] = columns.get(name, 0.0) + self._twice(k, slope)

    def respond_to(self, k: int, resisting: NDArray) -> NDArray:
        """Return the rows of run k for a resistance (n,) at its samples [N], or for many
        (n, columns) at once."""
        return self._twice(k, resisting)

    def _twice(self, k: int, samples: NDArray | float) -> NDArray:
        tau = self.runs[k].tau
        full = np.asarray(samples)
        full = full if full.ndim == 2 else np.broadcast_to(full, tau.shape)
        if self.imposed:
            return self._reduce(k, full)
        return self._reduce(k, integrate_smooth(integrate_smooth(full, tau), tau))


def integrate_held(force: NDArray, hold: NDArray) -> NDArray:
    """Return the twice integrated force (n,), which is held from sample to sample; exact."""
    once = np.concatenate(([0.0], np.cumsum(force * hold)[:-1]))
    steps = once * hold + force * hold**2 / 2
    return np.concatenate(([0.0], np.cumsum(steps)[:-1]))


def _delay_force(stretch: AxisStretch, times: NDArray, delay: float) -> tuple[NDArray, NDArray]:
    """The held force as it acts `delay` later, integrated twice and once, at `times` (n,)."""
    t, force = stretch.time, stretch.force
    once = np.concatenate(([0.0], np.cumsum(force[:-1] * np.diff(t))))
    twice = np.concatenate(
        ([0.0], np.cumsum(once[:-1] * np.diff(t) + force[:-1] * np.diff(t) ** 2 / 2))
    )
    k = np.clip(np.searchsorted(t, times - delay, side="right") - 1, 0, len(t) - 1)
    rest = times - delay - t[k]
    return twice[k] + once[k] * rest + force[k] * rest**2 / 2, once[k] + force[k] * rest


def integrate_smooth(samples: NDArray, tau: NDArray) -> NDArray:
    """The integral over time of smooth samples (n,) or (n, columns), by trapezia."""
    width = np.diff(tau) / 2
    once = np.zeros(samples.shape)
    steps = (samples[1:] + samples[:-1]) * (width if samples.ndim == 1 else width[:, None])
    np.cumsum(steps, axis=0, out=once[1:])
    return once
