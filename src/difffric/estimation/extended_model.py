"""The extended model against measured pushes: every effect of the catalogue in one program.

Coordinates are the plain parameters and all the effects' numbers, each effect at its null unless
a candidate says otherwise. The program answers for many pairs of a push and its coordinates at
once, with the Gram matrix of the whitened residuals and of their exact derivatives in a few
directions that are chosen when it is called: a score test, a scan and a refit of any subset run
the same compiled code. Axes: B pairs of a push and its coordinates, K coordinates, D directions.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.estimation.effect_coordinates import FORMED, Coordinates
from difffric.estimation.following.answer_by_program import StackedPushes, answer, answer_seldom
from difffric.estimation.following.answer_in_columns import answer_in_columns
from difffric.estimation.following.push_answer import AnswerRows, PushAnswer
from difffric.estimation.following.thread_pool import map_in_threads
from difffric.estimation.stacked_data import RECORDINGS
from difffric.rig import catalogue
from difffric.rig.rig import Rig
from difffric.timings import count_followed

PRESLIDING = "presliding"
BRISTLES = f"{PRESLIDING}.sigma_0_N_per_m"
BATCH = 4
"""Pairs that one call answers for: as many as are computed abreast. All wait for the longest."""
VALUES = 16
"""The same where no derivatives are asked for: fewer take no less time, more no less for each."""
STEPS, BENT_STEPS = 1000, 2000
"""Steps of the integrator that a push may take, and with bristles, which swing until they rest."""
FEW_STEPS = 256
"""As many as most recorded pushes take: those are followed with room for no more, which is a
quarter of all the memory that a call runs through."""


@dataclass(frozen=True)
class ExtendedModel:
    """Measured pushes, and a rig with all effects at their nulls, ready to be compared."""

    coordinates: Coordinates
    rig: Rig
    """with all effects that the coordinates know, but for bristles"""
    pushes: StackedPushes
    kind: str
    """`table`, `slides` or `recordings`"""
    directions: int = 8
    """in which the program differentiates; a call with fewer is padded, one with more asks it
    several times"""
    steps: int = STEPS
    plain: Any = None
    """the rig without any effect"""
    in_columns: bool = False
    """whether a table's pushes are followed by NumPy, which compiles nothing and knows only the
    effects of `list_served`"""

    @property
    def recordings(self) -> bool:
        """Whether whole samples are compared."""
        return self.kind == RECORDINGS

    @cached_property
    def _rig(self) -> Rig:
        return pytrees.as_arrays(self.rig)

    @cached_property
    def _bent(self) -> ExtendedModel:
        """The model with bristles, which no value makes vanish: a program of its own."""
        rig = catalogue.extended(self.rig, {PRESLIDING: {}})
        return replace(self, rig=rig, steps=BENT_STEPS)

    @cached_property
    def _unbent(self) -> ExtendedModel:
        """The model without bristles."""
        return replace(self, coordinates=self.coordinates.without(PRESLIDING))

    def _pick_rows(self, index: NDArray) -> StackedPushes:
        """Some pushes, by their numbers; the program does not know how many there are."""
        return jax.tree.map(lambda column: np.asarray(column)[index], self.pushes)

    def _make_example(self) -> tuple:
        """Arguments of the program, for their shapes."""
        K = len(self.coordinates.names)
        return (
            self._rig,
            self._pick_rows(np.zeros(self._batch, int)),
            np.zeros((self._batch, K)),
            np.zeros((self._batch, self.directions, K)),
        )

    @cached_property
    def _program(self) -> Callable[..., AnswerRows]:
        """The compiled program for these data."""
        at = self.coordinates
        given = ((at.names, at.null, at.unit), self.kind, self.steps)
        program = answer_seldom if self._has_forms and self.directions else answer
        program.prepare(*given, *self._make_example())
        return partial(program, *given)

    @property
    def _has_forms(self) -> bool:
        """Whether free forms are among the coordinates."""
        return not set(FORMED).isdisjoint(self.coordinates.names)

    @property
    def _batch(self) -> int:
        """Pairs that one call answers for."""
        return BATCH if self.directions else VALUES

    @cached_property
    def _valued(self) -> ExtendedModel:
        """The model without derivatives: a program of its own, ten times as fast."""
        return replace(self, directions=0)

    @cached_property
    def _brief(self) -> ExtendedModel:
        """The model that is asked first, with room for few steps where those are most often
        enough."""
        short = self.recordings and self.steps == STEPS
        return replace(self, steps=FEW_STEPS) if short else self

    def compile(self) -> None:
        """Make the programs ready; may be left to another thread. Those with bristles are not: few
        searches come to them."""
        with suppress(Exception):  # XLA has failed where two compiled at once; its use asks again
            _ = self._unbent._brief._program
            _ = self._unbent._valued._brief._program

    def answers(
        self, index: NDArray, c: NDArray, directions: NDArray, keep_rows: bool = False
    ) -> PushAnswer:
        """The answers for N pairs: pushes `index` (N,) at coordinates c (N, K), with derivatives
        along directions (N, D, K) or (D, K). NumPy arrays come back, Gram matrices of D + 1
        columns. Without directions, D = 0, it takes a tenth of the time."""
        directions = np.broadcast_to(directions, (len(c), *np.shape(directions)[-2:]))
        if self.in_columns:
            rows = self._pick_rows(index)
            found = answer_in_columns(self.coordinates, self.plain, rows, c, directions)
            count_followed(1, (len(c), len(c)), (directions.size // c.shape[1],) * 2)
            return AnswerRows(*found).compare(keep_rows)
        return self._ask_programs(index, c, directions, keep_rows)

    def _ask_programs(
        self, index: NDArray, c: NDArray, directions: NDArray, keep_rows: bool
    ) -> PushAnswer:
        """`answers` by compiled programs."""
        names = self.coordinates.names
        bent = c[:, names.index(BRISTLES)] > 0 if BRISTLES in names else np.zeros(len(c), bool)
        known = self.coordinates.indices(self._unbent.coordinates.names)
        if not bent.any():
            return self._unbent._answers(index, c[:, known], directions[..., known], keep_rows)
        parts = []
        for model, at, own in ((self._unbent, ~bent, known), (self._bent, bent, slice(None))):
            if at.any():
                asked = index[at], c[at][:, own], directions[at][..., own]
                parts.append(model._answers(*asked, keep_rows))
        back = np.argsort(np.argsort(bent, kind="stable"), kind="stable")
        return jax.tree.map(lambda *a: np.concatenate(a)[back], *parts)

    def _answers(
        self, index: NDArray, c: NDArray, directions: NDArray, keep_rows: bool
    ) -> PushAnswer:
        if not directions.shape[1] and self.directions:
            return self._valued._answers(index, c, directions, keep_rows)
        found = self._brief._answer_in_batches(index, c, directions, keep_rows)
        lost = np.isnan(found.residual).any(axis=(1, 2))
        if self._brief is not self and lost.any():
            again = self._answer_in_batches(index[lost], c[lost], directions[lost], keep_rows)
            for every, those in zip(jax.tree.leaves(found), jax.tree.leaves(again), strict=True):
                every[lost] = those
        return found

    def _answer_in_batches(
        self, index: NDArray, c: NDArray, directions: NDArray, keep_rows: bool
    ) -> PushAnswer:
        # A batch goes on for as long as its longest push: alike ones together.
        N, size = len(c), self._batch
        order = np.lexsort((index, np.asarray(self.pushes.velocity)[index]))
        index, c, directions = index[order], c[order], directions[order]
        parts = [slice(lo, min(lo + size, N)) for lo in range(0, N, size)]

        def answer_part(part: slice) -> PushAnswer:
            fill = np.minimum(np.arange(size), part.stop - part.start - 1)
            at = (self._pick_rows(index[part][fill]), c[part][fill])
            found = self._differentiate(*at, directions[part][fill])
            there = AnswerRows(*(a[: part.stop - part.start] for a in found))
            return there.compare(keep_rows)

        found = map_in_threads(answer_part, parts)
        D, asked, whole = directions.shape[1], self.directions, len(parts) * size
        calls = max(-(-D // asked), 1) if asked else 1
        count_followed(len(parts) * calls, (N, whole), (N * D, whole * calls * asked))
        back = np.argsort(order)
        return jax.tree.map(lambda *a: np.concatenate(a)[back], *found)

    def _differentiate(self, pushes: StackedPushes, c: NDArray, directions: NDArray) -> AnswerRows:
        """One batch's answers, from as many calls of the program as the directions take."""
        D, most = directions.shape[1], self.directions
        parts = []
        for lo in range(0, max(D, 1), max(most, 1)):
            some = directions[:, lo : lo + most]
            padded = np.zeros((len(c), most, c.shape[1]))
            padded[:, : some.shape[1]] = some
            rows, model = map(np.asarray, self._program(self._rig, pushes, c, padded))
            parts.append(rows[..., : some.shape[1]])
        return AnswerRows(np.concatenate([*parts, rows[..., -1:]], axis=-1), model)
