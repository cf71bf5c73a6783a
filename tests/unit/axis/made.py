"""Recordings of made axes as the library takes them."""

from __future__ import annotations

import numpy as np

from difffric.axis import AxisRecordings, AxisSetup, AxisStretch
from tests.reference.axis import Axis, Record, record

ROUGH = AxisSetup(mass=30.0, coulomb=55.0, k_v=70.0)
"""A set-up that is off by a factor of three, with no offset."""


def as_setup(axis: Axis) -> AxisSetup:
    """The truth as a set-up."""
    return AxisSetup(axis.mass, axis.coulomb, axis.breakaway, axis.k_v, offset=axis.offset)


def as_recording(made: Record, given: bool = True) -> AxisRecordings:
    """A recording whose stretches are given, or in one piece."""
    groups = [made.stretch == k for k in np.unique(made.stretch)]
    groups = groups if given else [np.ones(len(made.t), bool)]
    stretches = [
        AxisStretch(str(k), made.t[g], made.force[g], made.measured[g])
        for k, g in enumerate(groups)
    ]
    return AxisRecordings(stretches, are_given=given)


def make(axis: Axis, given: bool = True, **options) -> AxisRecordings:
    """A recording of an axis: eight seconds, three speeds."""
    short = {"speeds": (0.05, 0.1, 0.2), "travel": 0.1}
    return as_recording(record(axis, **(short | options)), given)
