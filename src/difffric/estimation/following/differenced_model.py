"""A model whose derivatives are differences of answers without any.

Exact derivatives take about eight times as long as an answer without them, whether one direction
is asked for or eight, and a program of their own. Where a derivative only says which way to go,
and where its program would be compiled for a minute to be asked some dozen times, the difference
of two answers side by side does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.following.push_answer import AnswerRows, PushAnswer

_STEP = 1e-5
"""Of a coordinate, between two answers: what it changes is linear, and above what an integrator
leaves open."""


@dataclass(frozen=True)
class DifferencedModel:
    """As the `model` that it asks, an `ExtendedModel`, in any number of directions at once."""

    model: Any
    directions: int = 1000

    def __getattr__(self, name: str) -> Any:
        return getattr(self.model, name)

    def answers(
        self, index: NDArray, c: NDArray, directions: NDArray, keep_rows: bool = False
    ) -> PushAnswer:
        """As `ExtendedModel.answers`."""
        N, D = len(c), np.shape(directions)[-2]
        steps = _STEP * np.broadcast_to(directions, (N, D, c.shape[1]))
        points = np.concatenate([c[None], c + np.moveaxis(steps, 1, 0)]).reshape(-1, c.shape[1])
        nothing = np.zeros((0, c.shape[1]))
        found = self.model.answers(np.tile(index, D + 1), points, nothing)
        r = found.residual.reshape(D + 1, N, *found.residual.shape[1:])
        columns = np.moveaxis(np.concatenate([(r[1:] - r[:1]) / _STEP, r[:1]]), 0, -1)
        return AnswerRows(columns, found.model[:N]).compare(keep_rows)
