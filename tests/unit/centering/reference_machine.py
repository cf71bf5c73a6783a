"""A machine that centres rings, made from the tests' own push and their own ring.

Only the form of its answers is the library's.
"""

from __future__ import annotations

import math

import numpy as np

from difffric.centering.machine import PushReadings
from difffric.centering.ring import measure
from tests.reference import rings, traces

RADIUS = 0.08
NOISE_FORCE, NOISE_POSITION = 0.5, 0.3e-6


class ReferenceMachine:
    """Hidden: the part's laws, its offset, mu_s of each push about a mean."""

    def __init__(self, laws, offset, random, *, mean, scatter=0.015, drift=0.0):
        self.laws, self.offset, self.random = dict(laws), np.array(offset, float), random
        self.mean, self.scatter, self.drift = mean, scatter, drift
        self.path = [self.offset]

    def measure(self):
        lobes = {2: (0.4e-6, -0.2e-6), 3: (0.3e-6, 0.1e-6)}
        angle, radius, _ = rings.readings(
            self.random, self.offset, RADIUS, n=72, lobes=lobes, noise=NOISE_POSITION
        )
        return measure(angle, radius, noise=NOISE_POSITION)

    def push(self, velocity, stroke, direction):
        mean = self.mean * math.exp(self.drift * (len(self.path) - 1))
        mu_s = mean * math.exp(self.scatter * self.random.standard_normal())
        course = traces.follow(mu_s=mu_s, v=velocity, stroke=stroke, **self.laws)
        x, d = course.answer.states[-1].x, course.sliding_distance
        self.offset = self.offset - x * np.array([math.cos(direction), math.sin(direction)])
        self.path.append(self.offset)
        force, position, twice = self.random.standard_normal(3)
        return PushReadings(
            peak_force=course.peak_force + NOISE_FORCE * force,
            peak_force_se=NOISE_FORCE,
            sliding_distance=math.nan if d is None else d + NOISE_POSITION * position,
            sliding_distance_se=NOISE_POSITION,
            displacement=x + math.sqrt(2) * NOISE_POSITION * twice,
            displacement_se=math.sqrt(2) * NOISE_POSITION,
            duration=max(course.end, stroke / velocity),
        )
