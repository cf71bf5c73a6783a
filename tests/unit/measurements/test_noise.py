"""The noise of a channel, from its own samples."""

from __future__ import annotations

import numpy as np
import pytest

from difffric.measurements.noise import estimate_noise


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
def test_the_variance_of_innovations_is_found_without_bias(phi):
    rng = np.random.default_rng(7)
    found = []
    for _ in range(100):
        e = rng.normal(0, 1, (14, 300))
        series = np.zeros_like(e)
        for j in range(1, 300):
            series[:, j] = phi * series[:, j - 1] + e[:, j]
        noise = estimate_noise(list(series[:, 100:]))
        found.append(noise.level**2 * (1 - noise.correlation**2))
    error = np.std(found) / np.sqrt(len(found))
    assert np.mean(found) == pytest.approx(1.0, abs=3.5 * error)
    assert error < 0.005
