"""Running sums judge every window about an edge as a fit to that window alone does."""

import numpy as np
import pytest

from difffric.measurements.noise import Noise
from difffric.measurements.reduction import edge_windows
from difffric.measurements.reduction.local_polynomials import Stretch, fit_rows, join_grams


@pytest.mark.parametrize("phi", [0.0, 0.7])
@pytest.mark.parametrize("block", [0.0, 1e-4])
def test_each_window_and_degree_is_judged_as_by_its_own_fit(phi, block):
    rng, t = np.random.default_rng(5), 3e-3 + 1e-4 * np.arange(80)
    y = 2 + 40 * np.maximum(0.6 - np.arange(80) / 80, 0) ** 1.3 + 0.5 * rng.standard_normal(80)
    stretch, i = Stretch(t, y, 1e-4, Noise(0.5, phi), block), 49
    left, right, degrees = [6, 11, 20, 40], [6, 15, 31], np.arange(1, 4)
    raw, white = edge_windows._make_rows(stretch, i, float(t[i]), 3e-3)
    gram = join_grams(raw, white, i, left, right).reshape(-1, *2 * [raw.shape[1]])
    size = np.add.outer(left, right).ravel()
    passed, width = edge_windows._judge(gram, size, degrees)
    seen = set()
    for k, order in enumerate(edge_windows._ORDERS):
        for window in range(len(size)):
            lo, hi = i - left[window // 3], i + right[window % 3]
            rows = white[lo:hi, order]
            rows[0] = raw[lo, order]
            fit = fit_rows(rows, k + 3, lo, hi)
            assert passed[k, window] == fit.passed
            seen.add(fit.passed > 0)
            if fit.passed:
                assert width[k, window] == pytest.approx(fit.se(1), rel=1e-6)
    assert seen == {True, False}
