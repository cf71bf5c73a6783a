"""Made probe readings of a ring whose offset is known: each ray from the axis is met with the
ring's surface by bisection, in the plane, without a formula for the distance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def distance(angle, centre, radius, lobes: Mapping[int, tuple[float, float]] | None = None):
    """From the axis to the surface [m] in the directions `angle` [rad]. `lobes`: order -> the
    amplitudes [m] of its cosine and sine about the ring's own `centre` [m]."""
    ray = np.stack([np.cos(angle), np.sin(angle)])

    def outside(r):
        x, y = r * ray - np.asarray(centre)[:, None]
        about = np.arctan2(y, x)
        form = sum(a * np.cos(n * about) + b * np.sin(n * about) for n, (a, b) in lobed)
        return np.hypot(x, y) > radius + form

    lobed = tuple((lobes or {}).items())
    inner, outer = np.zeros(len(angle)), np.full(len(angle), 3 * radius)
    for _ in range(70):
        middle = 0.5 * (inner + outer)
        far = outside(middle)
        inner, outer = np.where(far, inner, middle), np.where(far, middle, outer)
    return 0.5 * (inner + outer)


def readings(
    random, centre, radius, *, n=360, start=0.0, arc=2 * np.pi, lobes=None, noise=0.3e-6,
    outliers=0.0,
):  # fmt: skip
    """(angle [rad], radius [m], which are outliers) of n readings from `start` on over `arc`.

    Of the readings a share of `outliers` is off by 5 to 500 um, either way.
    """
    angle = start + arc * np.arange(n) / n
    measured = distance(angle, centre, radius, lobes) + noise * random.standard_normal(n)
    bad = random.random(n) < outliers
    off = random.choice([-1.0, 1.0], n) * random.uniform(5e-6, 500e-6, n)
    return angle, measured + bad * off, bad
