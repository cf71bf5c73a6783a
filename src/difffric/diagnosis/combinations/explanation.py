"""What explains a table of known friction: the best combination of causes, what each of its parts
buys, and what would do nearly as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.result import Fit
from difffric.diagnosis.combinations.beam_search import (
    DAMPING,
    VISCOSITY,
    BeamSearch,
    CauseCombination,
)
from difffric.diagnosis.combinations.robust_descent import KnownFriction, Points
from difffric.diagnosis.data import prepare_data
from difffric.diagnosis.extended_setup import strip_effects
from difffric.diagnosis.impossible_measurements import Certificate
from difffric.diagnosis.verdict import AMBIGUOUS, NAMED, UNEXPLAINED
from difffric.estimation.effect_coordinates import PLAIN
from difffric.estimation.following.answer_in_columns import list_served
from difffric.measurements.pushes import Pushes
from difffric.progress import Tell, silent
from difffric.rig import catalogue, parameters
from difffric.rig.catalogue import RATIO, component_of, numbers_of
from difffric.rig.rig import Rig
from difffric.rig.setup import Extras, Setup

ALIKE = 2 * np.log(20.0)
"""Costs within this of each other do not tell two combinations apart: odds of 20 to 1."""
CALIBRATED = ("pusher_speed", "force_gain", "force_offset", "probe_scale")
"""Effects of what a manufacturer calibrates: as large as is typical, with a normal distribution."""
_SHARE, _LEAST = 0.02, 0.01
"""Errors where none are known, as shares of a number and of the median one."""
_ROUNDS = 12
"""Steps of a combination's descent without the pushes that are held out."""


@dataclass(frozen=True)
class Explanation:
    """The combinations that were found, the best one's place among them, and what it is worth."""

    setup: Setup
    """the plain set-up"""
    table: KnownFriction
    stages: tuple[CauseCombination, ...]
    """the best of each number of parts, from none"""
    best: CauseCombination
    without: dict[str, CauseCombination]
    """the best one without each of its parts, all else fitted anew"""
    rivals: tuple[CauseCombination, ...]
    """others that the data hardly tell from it, the best first"""
    held_out: tuple[float, ...]
    """the error of each stage on held-out pushes, in units of the standard errors"""
    blind: tuple[Points, ...]
    """of each stage, where it stands without the pushes of each fold"""

    def list_values(self, one: CauseCombination) -> dict[str, float]:
        """The numbers of a combination [SI] by name."""
        coordinates = self.table.model.coordinates
        names = [coordinates.names[i] for i in one.points.free[0]]
        return dict(zip(names, coordinates.values(one.points.c[0], names), strict=True))

    def list_blind(self, one: CauseCombination) -> list[CauseCombination]:
        """A stage's combination where it stands without the pushes of each fold."""
        ends = self.blind[self.stages.index(one)]
        each = (ends.pick(np.array([j])) for j in range(len(ends.c)))
        return [replace(one, points=replace(points, seen=None)) for points in each]

    def extend_setup(self, one: CauseCombination) -> Setup:
        """The set-up with a combination's parts, which alone are free beside the stiffness."""
        values = self.list_values(one)
        plain = {DAMPING: 0.0, VISCOSITY: 0.0} | {n: x for n, x in values.items() if n in PLAIN}
        effects: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            effect, _, key = name.partition(".")
            if key:
                effects.setdefault(effect, {})[key] = value
        rig = catalogue.extended(parameters.with_values(self.setup.rig, plain), effects)
        free = {name: Extras(None, name in values, None, None) for name in (*plain, *values)}
        return replace(self.setup, rig=rig, extras={**self.setup.extras, **free})

    def describe_rivals(self) -> tuple[str, ...]:
        """Say of each rival what is in it in the best one's place, and what it costs."""
        best = self.best
        return tuple(
            f"{' and '.join(sorted(one.parts - best.parts))} in place of "
            f"{' and '.join(sorted(best.parts - one.parts))} explains these data nearly as "
            f"well (cost {one.cost:.1f} against {best.cost:.1f})"
            for one in self.rivals
        )

    def as_diagnosis(self, fit: Fit, certificates: Sequence[Certificate]) -> dict[str, Any]:
        """As `result.json` holds a diagnosis; `fit` is the best combination's calibration."""
        weights = [np.exp(0.5 * (self.best.penalised - one.penalised)) for one in self.rivals]
        causes = []
        for part in sorted(self.best.parts - {DAMPING, VISCOSITY}):
            lacking = [
                (w, one)
                for w, one in zip(weights, self.rivals, strict=True)
                if part not in one.parts
            ]
            others = {x for _, one in lacking for x in one.parts - self.best.parts}
            numbers = {
                ("ratio" if part == RATIO else name.partition(".")[2]): {
                    "value": fit.value(name),
                    "standard_error": fit.standard_error(name),
                }
                for name in numbers_of(part)
            }
            causes.append(
                {
                    "id": part,
                    "component": component_of(part),
                    "probability": float(1.0 / (1.0 + sum(w for w, _ in lacking))),
                    "confusable_with": sorted(others),
                    "parameters": numbers,
                    "chi2_drop": self.without[part].cost - self.best.cost,
                }
            )
        causes.sort(key=lambda cause: -cause["chi2_drop"])
        unsure = any(cause["confusable_with"] for cause in causes)
        return {
            "verdict": AMBIGUOUS if unsure else NAMED if causes else UNEXPLAINED,
            "causes": causes,
            "negligible": [],
            "certificates": [one.as_dict() for one in certificates],
            "location": None,
            "gain": {
                "heldout_nrmse_before": self.held_out[0],
                "heldout_nrmse_after": self.held_out[len(self.best.parts)],
                "noise_floor": 1.0,
            },
            "not_visible": [],
            "next_experiment": None,
        }


def explain_table(
    rig: Rig | Setup, pushes: Pushes, folds: NDArray, tell: Tell = silent
) -> Explanation:
    """Look for the combination of causes that explains a table whose mu_s a gauge knows.

    `folds` (n,) says which pushes are held out together.
    """
    setup = strip_effects(rig if isinstance(rig, Setup) else Setup(rig))[0]
    data = prepare_data(setup.rig, pushes, None, _assume_errors(pushes))
    model = replace(data.task.model, in_columns=True)
    coordinates, values = model.coordinates, parameters.values(setup.rig)
    base = np.zeros(len(coordinates.names))
    base[coordinates.indices(PLAIN)] = coordinates.point({n: float(values[n]) for n in PLAIN})
    precision = np.zeros(len(base))
    precision[coordinates.indices([n for e in CALIBRATED for n in numbers_of(e)])] = 1.0
    served = {*list_served(setup.rig), RATIO}
    effects = [e for e in data.looked_for if e in served and _is_told(e, pushes)]
    table = KnownFriction(model, np.log(pushes.mu_s_gauge), precision)
    search = BeamSearch(table, data.scales, effects, base, tell=tell)
    stages = [stage[0] for stage in search.run()]
    best = search.refine(min(stages, key=lambda one: one.penalised))
    stages[len(best.parts)] = best
    tell("what would do as well", 0.9)
    without = search.leave_out_each(best)
    rivals = [one for one in search.list_swapped(best) if one.penalised < best.penalised + ALIKE]
    blind = [table.leave_out_folds(one.points, folds, _ROUNDS) for one in stages]
    held_out = tuple(float(np.sqrt(table.predict_held_out(x).mean())) for x in blind)
    return Explanation(
        setup, table, tuple(stages), best, without, tuple(rivals), held_out, tuple(blind)
    )


def _is_told(effect: str, pushes: Pushes) -> bool:
    """Whether a table says what an effect needs."""
    return effect != "friction_drift" or bool(np.isfinite(pushes.order).all())


def _assume_errors(pushes: Pushes) -> NDArray:
    """(n, 2) standard errors of F_p and d, assumed where the table has none."""
    out: list[Any] = []
    for number, known in (
        (pushes.peak_force, pushes.peak_force_se),
        (pushes.sliding_distance, pushes.sliding_distance_se),
    ):
        middle = np.nanmedian(number) if np.isfinite(number).any() else np.nan
        out.append(np.where(np.isnan(known), np.hypot(_SHARE * number, _LEAST * middle), known))
    return np.stack(out, axis=1)
