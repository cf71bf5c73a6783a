"""The search for the parameters of an axis: Gauss-Newton under a noise that is found with them.

The first step needs no start: with the mass as a factor the equation is linear in all plain
parameters. From there the positions are what answers to the force (`driven`), which stays right
under a controller that reacts to noise and disturbances; where the forces of inertia drown, the
force is what answers to a motion that is imposed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from difffric.axis.effects import EFFECTS
from difffric.axis.motion_model import MotionModel, RunData, RunResiduals
from difffric.axis.noise_model import NoiseFit, NoiseProblem
from difffric.axis.setup import COULOMB, MASS, VISCOUS
from difffric.errors import InputError


@dataclass(frozen=True)
class SearchEnd:
    """Where a search ended."""

    values: dict[str, float]
    """all parameters"""
    names: tuple[str, ...]
    """of the free ones"""
    noise: NoiseFit
    problem: NoiseProblem
    imposed: bool
    converged: bool
    """whether the last step was small against the standard errors"""
    model: MotionModel

    @property
    def criterion(self) -> float:
        """-2 log restricted likelihood of the data; where the motion is driven, of positions."""
        return self.noise.criterion

    @property
    def log_likelihood(self) -> float:
        """-2 log likelihood of the positions, whatever rate the model was made for."""
        if self.imposed:
            return self.noise.log_likelihood
        rate = self.values[VISCOUS] / self.values[MASS]
        return self.noise.log_likelihood - (rate - self.model.rate) * self.model.duration


_MOST_ROUNDS = 12
"""Rounds of a search at most; three are usual."""
_WORSE = 0.5
"""Rise of -2 log likelihood from which on a step was too long, and is halved."""
_SMALL = 0.03
"""Step, in standard errors, below which a search has converged."""
_NEAR = 0.02
"""Change of -2 log likelihood that is not worth a new model."""
_AGAINST = 20.0
"""Standard errors below 0 from which on a mass says that a sign is wrong."""
_IDLE = 3.0
"""Standard errors that a force must differ by from one way to the other."""
_CLEAR_MASS = 6.0
"""Standard errors that a mass must differ from 0 by, for the motion to count as driven."""


def find_start(
    runs: Sequence[RunData], values: Mapping[str, float], names: Sequence[str]
) -> tuple[dict[str, float], bool]:
    """Return where a search begins, and whether the motion is imposed.

    `values` are those of the set-up, which hold for what is not free. Raises `InputError` where
    the axis goes against the force that drives it.
    """
    model = MotionModel(runs)
    plain = [x for x in names if "." not in x]
    tried = [MASS, *(x for x in plain if x != MASS)]
    zero = {**values, **dict.fromkeys(tried, 0.0)}
    found = model.evaluate(zero, tried)
    levels = model.evaluate({**zero, COULOMB: values[COULOMB]}, tried).levels
    noise = NoiseProblem(model.rows, [-e for e in found.errors], found.slopes, levels).fit()
    mass, error = noise.step[0], np.sqrt(noise.covariance[0, 0])
    if mass < -_AGAINST * error:
        raise InputError(
            f"the axis accelerates against the recorded force (its mass would be {mass:.3g} kg): "
            "is the sign of the force or of the position wrong? (a negative gain_N_per_V turns "
            "that of a drive in volts)"
        )
    imposed = bool(mass < _CLEAR_MASS * error)
    if imposed:
        _refuse_idle_force(runs)
        return dict(values), True
    start = dict(values)
    for name, value in zip(tried, noise.step, strict=True):
        if name in plain:
            start[name] = float(value)
    return start, False


def _refuse_idle_force(runs: Sequence[RunData]) -> None:
    """Refuse forces that do not answer to a motion that is imposed.

    Raises `InputError` where forwards they are not clearly above what they are backwards.
    """
    means = {s: np.array([r.force.mean() for r in runs if r.run.sign == s]) for s in (1, -1)}
    if min(map(len, means.values())) < 2:
        return
    half = float(means[1].mean() - means[-1].mean()) / 2
    error = float(np.sqrt(sum(x.var(ddof=1) / len(x) for x in means.values()))) / 2
    if half > _IDLE * error:
        return
    asked = "is its sign, or that of the position, wrong?" if half < -_IDLE * error else (
        "is its channel the drive's?"
    )  # fmt: skip
    raise InputError(
        "the recorded force does not answer to the motion: half the difference between forwards "
        f"and backwards is {half:.2g} ± {error:.1g} N, expected Coulomb friction; {asked}"
    )


def search(
    runs: Sequence[RunData],
    start: Mapping[str, float],
    names: Sequence[str],
    imposed: bool,
    sizes: np.ndarray | None = None,
    hold_noise: bool = False,
    model: MotionModel | None = None,
) -> SearchEnd:
    """Return the best values of the named parameters, and the noise with them.

    With `hold_noise` the noise stays of these sizes. A `model` that is near enough saves making
    one for the rate at which the axis forgets its speed.
    """
    values, converged = dict(start), False
    given = model
    model = given or _make_model(runs, values, imposed)
    problem, noise = _pose(model, values, names), None
    best = None
    for _ in range(_MOST_ROUNDS):
        held = sizes if hold_noise else None
        noise = problem.fit(sizes) if held is None else problem.solve(held)[0]
        sizes = noise.sizes
        if imposed:
            noise = problem.weigh_equally(noise)
        errors = np.sqrt(np.maximum(np.diag(noise.covariance), 1e-300))
        if best is not None and noise.before_step > best[2].before_step + _WORSE:
            values = {x: 0.5 * (values[x] + best[0][x]) for x in values}
            problem = _pose(model, values, names)
            continue
        best = (dict(values), problem, noise, model)
        if np.max(np.abs(noise.step) / errors, initial=0.0) < _SMALL:
            converged = True
            break
        values = {
            **values,
            **{
                name: _take_step(name, values[name], float(step))
                for name, step in zip(names, noise.step, strict=True)
            },
        }
        if given is None and _is_far(model, values):
            model = _make_model(runs, values, imposed)
        problem = _pose(model, values, names)
    assert best is not None
    values, problem, noise, model = best
    return SearchEnd(values, tuple(names), noise, problem, imposed, converged, model)


def _make_model(runs: Sequence[RunData], values: Mapping[str, float], imposed: bool) -> MotionModel:
    rate = 0.0 if imposed else max(values[VISCOUS] / values[MASS], 0.0)
    return MotionModel(runs, rate, imposed)


def _is_far(model: MotionModel, values: Mapping[str, float]) -> bool:
    """Whether a model was made for a rate that would now count as another likelihood."""
    if model.imposed:
        return False
    rate = max(values[VISCOUS] / values[MASS], 0.0)
    return abs(rate - model.rate) * model.duration > _NEAR


def _pose(model: MotionModel, values: Mapping[str, float], names: Sequence[str]) -> NoiseProblem:
    """The linear problem of a step from these values."""
    return pose_step(model, model.evaluate(values, names), values, names)


def pose_step(
    model: MotionModel, found: RunResiduals, values: Mapping[str, float], names: Sequence[str]
) -> NoiseProblem:
    """Return the linear problem of a step: the errors of position [m], or of force where the
    motion is imposed, against what each parameter changes of them."""
    if model.imposed:
        targets = [-e for e in found.errors]
        return NoiseProblem(model.rows, targets, found.slopes, found.levels)
    mass = values[MASS]
    targets = [-e / mass for e in found.errors]
    columns = [s / mass for s in found.slopes]
    if MASS in names:
        k = [*names].index(MASS)
        for column, error in zip(columns, found.errors, strict=True):
            column[:, k] -= error / mass**2
    return NoiseProblem(model.rows, targets, columns, [z / mass for z in found.levels])


def _take_step(name: str, value: float, step: float) -> float:
    """The value after a step, which leaves no mass, no Coulomb friction and no length below a
    third of what it was."""
    effect, dot, key = name.partition(".")
    positive = name in (MASS, COULOMB)
    if dot:
        positive = next(x for x in EFFECTS[effect].keys if x.name == key).is_scanned
    if positive and value > 0:
        return float(np.clip(value + step, value / 3, 3 * value))
    return value + step
