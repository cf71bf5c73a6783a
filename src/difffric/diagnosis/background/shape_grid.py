"""The columns of all shapes over their grids, kept for as long as a fit hardly moves."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from difffric.diagnosis.background.columns.shape_columns import (
    MOVABLE,
    WAVES,
    ShapeColumns,
    compute_columns,
    divide_turns,
    get_ways,
    join_columns,
    list_nearby,
    list_placed,
    list_shapes,
)
from difffric.diagnosis.background.evidence import Evidence
from difffric.diagnosis.background.shape_pursuit import choose_best_shapes
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.diagnosis.background.wave_response import (
    choose_lengths,
    make_wave_columns,
    sample_waves,
)
from difffric.diagnosis.data import DiagnosisData
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import numbers_of

_NEAR = 1.0
"""Root mean square, in units of the noise, by which a fit may move until the columns of shapes are
computed anew: they change by as small a share as what the model says does."""


@dataclass
class ShapeGrid:
    """The shapes of the `effects` over their grids, and what they change where a fit stands."""

    data: DiagnosisData
    effects: Sequence[str]
    background: bool
    _kept: dict[str, tuple[Fits, bool, Any]] = field(default_factory=dict)
    """of each effect: the fit, whether it has the effect, and what was asked there"""

    def weigh(
        self,
        small: SmallEffects,
        at: Fits,
        shaped: Sequence[str],
        effects: Sequence[str] | None = None,
    ) -> Evidence:
        """Make the comparison where the fit `at` stands, which has shapes of the effects `shaped`:
        of those the placed shape, and, of waves and patches, those that could be in its place.
        Shapes are looked for of some `effects` (default: all)."""
        task = self.data.task
        wanted = [
            effect
            for effect in (self.effects if effects is None else effects)
            if effect not in shaped or effect in MOVABLE
        ]
        waves = [effect for effect in wanted if effect in WAVES]
        self._ask_shapes(at, shaped, [effect for effect in wanted if effect not in WAVES])
        columns = [self._kept[effect][2] for effect in wanted if effect not in WAVES]
        if shaped:
            columns = [compute_columns(task, at, list_placed(task, at, shaped)), *columns]
        joined = join_columns(*columns) if columns else None
        evidence = Evidence(task, at, small, joined, self.background)
        more = self._compute_nearby(at, shaped, evidence)
        more += [self._compute_waves(at, shaped, effect, evidence) for effect in waves]
        return evidence.add_columns(*more) if more else evidence

    def _ask_shapes(self, at: Fits, shaped: Sequence[str], effects: Sequence[str]) -> None:
        """Ask what the shapes of some effects change, where that is not known."""
        task = self.data.task
        stale = [x for x in effects if not self._is_kept(x, at, x in shaped)]
        for some in ([x for x in stale if x not in shaped], *([x] for x in stale if x in shaped)):
            if some:
                shapes = list_shapes(task, some, self.data.scales)
                bare = leave_out(task, at, set(some) & set(shaped))
                columns = compute_columns(task, bare, shapes)
                for effect in some:
                    self._kept[effect] = at, effect in shaped, columns.pick([effect])

    def _compute_nearby(
        self, at: Fits, shaped: Sequence[str], evidence: Evidence
    ) -> list[ShapeColumns]:
        """The columns of places near the best ones: one that lies between two of the grid is to
        count as much as one that is on it."""
        task = self.data.task
        found = []
        for best in choose_best_shapes(evidence, 1):
            one = best.items[0].shape
            if one is not None and one.along is not None:
                bare = leave_out(task, at, {one.effect} & set(shaped))
                found.append(compute_columns(task, bare, list_nearby([one])))
        return found

    def _compute_waves(
        self, at: Fits, shaped: Sequence[str], effect: str, evidence: Evidence
    ) -> ShapeColumns:
        """The columns of an effect's waves, of each cell the one that explains the most."""
        task = self.data.task
        ways = get_ways(effect, self.data.scales)
        cells = divide_turns(ways)
        if not self._is_kept(effect, at, effect in shaped):
            bare = leave_out(task, at, {effect} & set(shaped))
            response = sample_waves(task, bare, effect, ways, float(cells[-1]))
            self._kept[effect] = at, effect in shaped, response
        response = self._kept[effect][2]
        turns = choose_lengths(evidence, response, cells)
        return make_wave_columns(task, effect, response, turns)

    def _is_kept(self, effect: str, at: Fits, shaped: bool) -> bool:
        """Whether what is kept of an effect was asked of a fit that is hardly another one."""
        there, was_shaped, _ = self._kept.get(effect, (None, False, None))
        return there is not None and was_shaped == shaped and is_near(self.data.task, there, at)


def leave_out(task: EnsembleTask, at: Fits, effects: Collection[str]) -> Fits:
    """Return the fit `at` (an ensemble of one) without the shapes of some effects, all else as it
    is, and without its answers."""
    if not effects:
        return at
    index = task.model.coordinates.indices([n for effect in effects for n in numbers_of(effect)])
    c = at.c.copy()
    c[0, index] = 0.0
    extra = tuple(i for i in at.extra[0] if i not in index)
    return replace(at, c=c, extra=(extra,), gram=None, residual=None, damping=None)


def is_near(task: EnsembleTask, one: Fits, other: Fits) -> bool:
    """Whether two fits (ensembles of one) differ by less than `_NEAR` of the noise."""
    if one is other:
        return True
    if one.residual is None or other.residual is None:
        return False
    between = (one.residual[0] - other.residual[0]) / other.spread[0][:, None]
    return float((between**2).sum()) < _NEAR**2 * float(task.counts.sum())
