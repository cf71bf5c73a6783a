"""mu_s from the distance of a free slide."""

from __future__ import annotations

import numpy as np
import pytest

import difffric as df
from difffric.compute import pytrees
from difffric.identification.free_slide import invert_slides
from tests.reference.traces import slide


@pytest.mark.parametrize("k_v", [0.0, 3.0, 60.0])
def test_a_slide_is_inverted_exactly(k_v):
    v, mu = np.array([0.02, 0.1, 0.6]), np.array([0.05, 0.15, 0.4])
    d = np.array([slide(18.9, m, 0.75, k_v, u) for m, u in zip(mu, v, strict=True)])
    rigs = pytrees.replicate(df.spring_damper_rig(mass=18.9, mu_s=0.1, k=8e5, b=1500.0, k_v=k_v), 3)
    found, _ = invert_slides(rigs, v, d)
    np.testing.assert_allclose(found, mu, rtol=1e-9)
