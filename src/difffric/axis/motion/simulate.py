"""The motion of an axis under a given force, with exact derivatives.

    m u' = force(t) + offset - (F_c + k_v |u|) sign(u) while it moves, up to F_s while it sticks

The force is held from sample to sample. A plain axis is followed run by run (`run_recursion`), one
with effects, or at uneven times, sample by sample (`stepped_motion`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from difffric.axis.motion.run_recursion import follow_runs
from difffric.axis.motion.stepped_motion import step_motion
from difffric.axis.motion.trajectory import AxisTrajectory
from difffric.axis.setup import AxisSetup
from difffric.errors import InputError


def simulate_axis(
    setup: AxisSetup,
    force: ArrayLike,
    time: ArrayLike,
    *,
    position: float = 0.0,
    speed: float = 0.0,
) -> AxisTrajectory:
    """Return the motion under forces (n,) [N], each held from its time (n,) [s] to the next.

    It begins at `position` [m] with `speed` [m/s]. Raises `InputError` where the arrays do not go
    together or time does not grow.
    """
    F, t = np.asarray(force, float), np.asarray(time, float)
    if F.ndim != 1 or F.shape != t.shape or len(t) < 2:
        raise InputError(
            f"expected force and time of one shape (n,), n > 1; got {F.shape}, {t.shape}"
        )
    if not (np.isfinite(F).all() and np.isfinite(t).all() and (np.diff(t) > 0).all()):
        raise InputError("expected finite forces, and times that grow")
    hold = np.diff(t)
    is_even = np.allclose(hold, hold[0], rtol=1e-6, atol=0)
    if setup.effects or not is_even:
        return step_motion(setup, F, t, position, speed)
    return follow_runs(setup.values, F, t, float(np.mean(hold)), position, speed)
