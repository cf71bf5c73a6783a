"""The rigs of measured pushes: one rig, with each push's own mass and stroke."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from difffric.compute.pytrees import replicate
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.rig import Rig


def make_push_rigs(rig: Rig, pushes: Pushes) -> Rig:
    """The rig spread over n pushes: each number of it an array (n,).

    A push that says its mass [kg] or its stroke [m] has that one, any other the rig's; one whose
    tip's motion was recorded moves so.
    """
    rigs = replicate(rig, len(pushes))
    mass = np.where(np.isnan(pushes.mass), rigs.mass, pushes.mass)
    strokes = pushes.motion
    if strokes is None:
        strokes = fill_strokes(rig.pusher.stroke, pushes.stroke)
    return parameters.override(rigs, {"mass_kg": mass}, strokes)


def fill_strokes(own: float | None, stroke: NDArray) -> NDArray | None:
    """Each push's stroke [m] (n,), infinite without one: what the push says, else the rig's `own`.
    None where neither the rig nor any push has one."""
    if own is None and np.isnan(stroke).all():
        return None
    return np.where(np.isnan(stroke), np.inf if own is None else float(own), stroke)
