"""A rig whose answers are linear in everything, so that what statistics says of fits is exact."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from difffric.estimation.ensemble import EnsembleTask, Fits
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

    @property
    def coordinates(self):
        """Without bounds."""
        names = ("mu_s", *self.names)
        return SimpleNamespace(
            names=names,
            indices=lambda some: [names.index(x) for x in some],
            bounds=lambda name: (-np.inf, np.inf),
        )

    def answers(self, index, c, directions, keep_rows=False):
        """As `ExtendedModel.answers`."""
        at = np.einsum("nik,nk->ni", self.slopes[index], c)
        rows = np.broadcast_to(directions, (len(c), *np.shape(directions)[-2:]))
        J = -np.einsum("nik,ndk->nid", self.slopes[index], rows)
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
