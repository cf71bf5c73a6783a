"""Noise of first order, AR(1), made and undone."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter


def coloured(n: int, sigma: float, phi: float, rng: np.random.Generator) -> np.ndarray:
    """n stationary samples e_i = phi e_(i-1) + innovation, each of standard deviation sigma."""
    innovation = rng.standard_normal(n)
    innovation[1:] *= math.sqrt(1 - phi**2)
    return sigma * np.asarray(lfilter([1.0], [1.0, -phi], innovation))


def whitened(samples: np.ndarray, sigma: float, phi: float, kept: np.ndarray) -> np.ndarray:
    """Columns of samples, where kept, such that this noise in them is white and of deviation 1.

    What was left out between two kept samples, m of them, leaves e_j - phi^(m + 1) e_i, whose
    variance is sigma^2 (1 - phi^(2 m + 2)).
    """
    at = np.flatnonzero(kept)
    found = np.asarray(samples, float)[at]
    if phi == 0 or len(at) == 0:
        return found / sigma
    linked = phi ** np.diff(at).astype(float)
    shape = (-1,) + (1,) * (found.ndim - 1)
    white = found.copy()
    white[1:] -= linked.reshape(shape) * found[:-1]
    white[1:] /= np.sqrt(1 - linked**2).reshape(shape)
    return white / sigma
