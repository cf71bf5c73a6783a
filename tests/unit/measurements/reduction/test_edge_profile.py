"""The chi-square over the edge, from running sums, is that of least squares with each edge."""

import numpy as np
import pytest

from difffric.measurements.noise import Noise, make_whitening
from difffric.measurements.reduction.edge_profile import EdgeProfile
from difffric.measurements.reduction.edge_windows import average_powers
from difffric.measurements.reduction.local_polynomials import Stretch

DT, N = 1e-4, 80


def fall(noise, block=0.0):
    """Samples of a force that falls to its level about the middle."""
    rng, t = np.random.default_rng(5), 3e-3 + DT * np.arange(N)
    y = 2 + 60 * np.maximum(0.6 - np.arange(N) / N, 0) ** 1.3 + 0.5 * rng.standard_normal(N)
    return Stretch(t, y, DT, noise, block)


@pytest.mark.parametrize("phi", [0.0, 0.7, -0.3])
@pytest.mark.parametrize("block", [0.0, DT])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_profile_is_least_squares_with_each_edge(phi, block, degree):
    stretch, scale, lo, hi = fall(Noise(0.5, phi), block), 3e-3, 2, N - 3
    edges = np.linspace(stretch.t[35], stretch.t[60], 31)
    chi2, slopes = EdgeProfile(stretch, lo, hi, degree, edges[-1], scale)(edges)
    white = make_whitening(np.arange(lo, hi), stretch.noise)
    for edge, found, slope in zip(edges, chi2, slopes, strict=True):
        falling = average_powers((stretch.t[lo:hi] - edge) / scale, block / scale, degree)
        rows = white(np.column_stack([np.ones(hi - lo), falling]))
        values = white(stretch.y[lo:hi])
        solution = np.linalg.lstsq(rows, values, rcond=None)[0]
        assert found == pytest.approx(np.sum((values - rows @ solution) ** 2), abs=1e-6)
        assert slope == pytest.approx(solution[1], rel=1e-6)
