"""The frictional state of a part: a level of mu_s that wanders slowly. It is seen at several
speeds, which differ by a little, as the model is a little wrong.

The local level model (Harvey, Forecasting, Structural Time Series Models and the Kalman Filter,
1989, chapter 4.1) with an offset for each speed but the first:

    y_n = x_n + o_speed(n) + e_n,   x_n = x_(n-1) + w_n,   e ~ N(0, r_n),   w ~ N(0, q).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

OFFSET = 0.1
"""Standard deviation of a speed's offset before anything is known of it, relative to mu_s."""
WANDER = 0.1
"""Standard deviation of w over that of the scatter: the level then follows about ten pushes."""
_FARTHEST = 4.0  # standard deviations; a number further out counts as this, as it may be wild


@dataclass
class Level:
    """The state of Kalman's filter: the level x of log mu_s and the offsets of the speeds."""

    cells: list[str] = field(default_factory=list)
    """the part's speeds; the first has no offset"""
    mean: list[float] = field(default_factory=list)
    """x, then the offsets of the speeds `cells[1:]`"""
    covariance: list[list[float]] = field(default_factory=list)
    """of `mean`"""

    def see(self, cell: str, y: float, r: float, q: float) -> None:
        """Take in one number y of variance r at a speed; w has the variance q."""
        if not self.cells:
            self.cells, self.mean, self.covariance = [cell], [y], [[r]]
            return
        m, P = np.array(self.mean), np.array(self.covariance)
        P[0, 0] += q
        if cell not in self.cells:
            self.cells.append(cell)
            m = np.append(m, 0.0)
            P = np.pad(P, (0, 1))
            P[-1, -1] = OFFSET**2
        H = np.zeros(len(m))
        H[0] = 1.0
        if (at := self.cells.index(cell)) > 0:
            H[at] = 1.0
        S = H @ P @ H + r
        gain = P @ H / S
        far = _FARTHEST * np.sqrt(S)
        m = m + gain * np.clip(y - H @ m, -far, far)
        P = P - np.outer(gain, H @ P)
        self.mean, self.covariance = m.tolist(), (0.5 * (P + P.T)).tolist()

    def forget(self) -> None:
        """Forget the level, as it has changed by nobody knows how much; the offsets stay."""
        if self.cells:
            n = len(self.cells)
            P = np.array(self.covariance)
            P[0, :], P[:, 0] = 0.0, 0.0
            P[0, 0] = 1.0
            self.covariance = P.reshape(n, n).tolist()

    @property
    def log_mu_s(self) -> tuple[float, float]:
        """log mu_s at the part's first speed, and its standard error."""
        return self.mean[0], float(np.sqrt(self.covariance[0][0]))
