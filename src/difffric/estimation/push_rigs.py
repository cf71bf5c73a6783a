"""The rigs of measured pushes: one rig, with each push's own mass and stroke."""

from __future__ import annotations

import numpy as np

from difffric.compute.pytrees import replicate
from difffric.estimation.stacked_data import find_strokes
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.rig import Rig


def make_push_rigs(rig: Rig, pushes: Pushes) -> Rig:
    """The rig spread over n pushes: each number of it an array (n,).

    A push that says its mass [kg] or its stroke [m] has that one, any other the rig's.
    """
    rigs = replicate(rig, len(pushes))
    mass = np.where(np.isnan(pushes.mass), rigs.mass, pushes.mass)
    _, strokes = find_strokes(rig, pushes.stroke)
    none = rig.pusher.stroke is None and np.isinf(strokes).all()
    return parameters.override(rigs, {"mass_kg": mass}, None if none else np.asarray(strokes))
