"""The model's numbers for many pushes at many mu_s each, with their derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.batched_answers import compute_answers, stack_measured
from difffric.compute.pytrees import pick
from difffric.estimation.descent import Model
from difffric.estimation.following.respond_in_columns import respond_in_columns
from difffric.estimation.stacked_data import FitData
from difffric.simulation.columns import serves

_STEP = 1e-4
"""Of a coordinate, for derivatives by differences where no exact ones are to be had."""


class NodeAnswers(NamedTuple):
    """Unweighted residuals of some pushes, at some points of mu_s each."""

    r: NDArray
    """(points, pushes, rows) measured less model; 0 where nothing was measured"""
    J: NDArray
    """(points, pushes, rows, coordinates) its derivatives; 0 for what is not free"""


class Answerer:
    """Answers for the pushes of one fit: in plain NumPy where the rig allows, else by the compiled
    program of values, with derivatives by differences."""

    def __init__(self, model: Model, data: FitData):
        layout = model.layout
        self.model, self.data = model, data
        free = np.asarray(layout.selection.any(axis=(0, 2)))
        free[0] = True  # each push's own mu_s is the first coordinate
        self.directions = np.flatnonzero(free)
        self.measured = stack_measured(data)[:, -data.weights.shape[1] :]
        self.in_columns = serves(model.rig, model.integrator)

    def answer(self, theta: NDArray, own: NDArray, which: NDArray) -> NodeAnswers:
        """Residuals of the pushes `which` (m,) at shared coordinates `theta` (P,) and at own log
        mu_s beyond the shared (points, m)."""
        if self.in_columns:
            return self._answer_in_columns(theta, own, which)
        values, by = self._answer_by_differences(theta, own, which)
        seen = self.measured[which]
        # As in a descent: a part that never leaves the tip slides no distance.
        exists = np.isfinite(values) & np.isfinite(seen)
        r = np.where(np.isfinite(seen), seen - np.where(np.isnan(values), 0.0, values), 0.0)
        J = np.zeros((*r.shape, self.model.layout.fixed.shape[1]))
        J[..., self.directions] = np.where(exists[..., None], -np.nan_to_num(by), 0.0)
        return NodeAnswers(r, J)

    def _answer_in_columns(self, theta: NDArray, own: NDArray, which: NDArray) -> NodeAnswers:
        layout, index = self.model.layout, np.tile(which, len(own))
        c = layout.fixed[index] + layout.selection[index] @ theta
        c[:, 0] += own.ravel()
        pushes = pick(self.data.pushes, index)
        rows = respond_in_columns(self.model.rig, pushes, c, self.directions.tolist()).rows
        rows = rows.reshape(*own.shape, *rows.shape[1:])
        return NodeAnswers(rows[..., -1], rows[..., :-1])

    def _answer_by_differences(
        self, theta: NDArray, own: NDArray, which: NDArray
    ) -> tuple[NDArray, NDArray]:
        """(points, m, rows) values and (points, m, rows, directions) derivatives, from the compiled
        program by central differences."""
        layout, points = self.model.layout, len(own)
        every = np.zeros((points, self.data.n))
        every[:, which] = own
        shifts, beside = [np.zeros_like(theta)], [np.zeros(1)]
        for k in self.directions:
            # The columns of one coordinate, one a condition, concern different pushes.
            moved = layout.selection[:, k].any(axis=0) & (k > 0)
            for sign in (_STEP, -_STEP):
                shifts.append(np.asarray(sign * moved))
                beside.append(np.array([sign * (k == 0)]))
        thetas = np.repeat(theta + np.array(shifts), points, axis=0)
        owns = np.concatenate([every + x for x in beside])
        rows = self.measured.shape[1]
        found = compute_answers(self.model, self.data, thetas, owns)[:, which, -rows:]
        found = found.reshape(-1, points, *found.shape[1:])
        by = (found[1::2] - found[2::2]) / (2 * _STEP)
        return found[0], np.moveaxis(by, 0, -1)
