"""The rigs of measured pushes: one rig, with each push's own mass and stroke."""

from __future__ import annotations

import numpy as np

from difffric.compute.pytrees import replicate
from difffric.estimation.stacked_data import find_strokes
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.rig import Rig


def rigs_of(rig: Rig, pushes: Pushes) -> Rig:
    """The rig spread over n pushes: each number of it an array (n,).

    A push that says its mass [kg] or its stroke [m] has that one, any other the rig's.
    """
    rigs = replicate(rig, len(pushes))
    mass = np.where(np.isnan(pushes.mass), rigs.mass, pushes.mass)
    rigs = parameters.with_values(rigs, {"mass_kg": mass})
    _, strokes = find_strokes(rig, pushes.stroke)
    if rig.pusher.stroke is None and np.isinf(strokes).all():
        return rigs
    return parameters.with_stroke(rigs, np.asarray(strokes))
