"""What a compiled model says of one push: derivatives, residuals, F_p and d."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

Array = Any  # NumPy's outside a compiled program, JAX's within


class PushAnswer(NamedTuple):
    """What the program answers for one pair of a push and its coordinates."""

    gram: Array
    """(2, D + 1, D + 1) of [J | r] of force and position, r = measured - model, whitened"""
    model: Array
    """(2,) F_p [N] and d [m]; NaN: there is none"""
    residual: Array
    """(2, m) whitened; of a table m = 1"""
    rows: Any = None
    """(2, m, D + 1): [J | r] themselves; None where they were not asked for"""


class AnswerRows(NamedTuple):
    """What a program computes for one pair of a push and its coordinates."""

    rows: Array
    """(2, m, D + 1): [J | r], J the derivatives of r, whitened"""
    model: Array
    """(2,) as in `PushAnswer`"""

    def compare(self, keep_rows: bool) -> PushAnswer:
        """What a fit takes of them; NumPy's arrays."""
        gram = np.swapaxes(self.rows, -1, -2) @ self.rows
        residual = self.rows[..., -1].copy()
        return PushAnswer(gram, self.model, residual, self.rows if keep_rows else None)
