"""A rig whose answers are linear in everything, so that what statistics says of fits is exact; or
in everything but log mu_s, as a force is."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.following.push_answer import AnswerRows


@dataclass
class LinearModel:
    """n pushes of two numbers each, in units of their noise."""

    slopes: np.ndarray
    """(n, 2, K) by the coordinates, log mu_s first"""
    measured: np.ndarray
    """(n, 2)"""
    names: tuple[str, ...]
    """of the coordinates after log mu_s"""
    recordings: bool = False
    directions: int = 8
    exponential: bool = False
    """whether the first coordinate counts by its exponential: as mu_s itself"""

    @property
    def coordinates(self):
        """Without bounds, all in their own units."""
        names = ("mu_s", *self.names)
        return SimpleNamespace(
            names=names,
            indices=lambda some: [names.index(x) for x in some],
            bounds=lambda name: (-np.inf, np.inf),
            point=lambda values: np.array(list(values.values())),
            unit=np.ones(len(names)),
            null=np.zeros(len(names)),
        )

    def answers(self, index, c, directions, keep_rows=False):
        """As `ExtendedModel.answers`."""
        slopes = self.slopes[index]
        if self.exponential:
            mu_s = np.exp(c[:, 0])
            c = np.column_stack([mu_s, c[:, 1:]])
        at = np.einsum("nik,nk->ni", slopes, c)
        if self.exponential:
            slopes = np.concatenate([slopes[..., :1] * mu_s[:, None, None], slopes[..., 1:]], 2)
        rows = np.broadcast_to(directions, (len(c), *np.shape(directions)[-2:]))
        J = -np.einsum("nik,ndk->nid", slopes, rows)
        A = np.concatenate([J, (self.measured[index] - at)[:, :, None]], axis=2)
        return AnswerRows(A[:, :, None, :], at).compare(keep_rows)


def make_task(slopes, measured, names, shared=()) -> EnsembleTask:
    """The task of fitting such pushes, all under one condition."""
    n = len(measured)
    model = LinearModel(slopes, measured, names)
    return EnsembleTask(model, shared, np.zeros(n, int), counts=np.ones((n, 2)))  # type: ignore


def start(task: EnsembleTask, scatter: float) -> Fits:
    """An ensemble of one at the origin."""
    K = 1 + len(task.model.names)  # type: ignore
    zeros = np.zeros((1, task.n))
    at = np.zeros((1, K)), np.zeros((1, 1)), zeros, np.array([scatter]), np.ones((1, 2))
    return Fits(((),), *at)
