"""Many pushes in columns, by plain NumPy: F_p, d and their exact derivatives where every law is
affine, or friction's alone bends with the speed, in a process that needs no JAX.

The equations are those that JAX compiles (`closed_form`, `segments`), and so are the answers, to
rounding, or to the tolerance of steps. Some thousand pushes take less time than a compiled program
takes to load.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from difffric.compute import arrays as xp
from difffric.compute.dual_numbers import Dual
from difffric.compute.lanes import count_lanes, differentiate, join_lanes, pick_lanes, spread
from difffric.compute.pytrees import list_leaves, map_tree
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.observables import Observables, observe_segments
from difffric.simulation.segments import Push
from difffric.simulation.stepping.stepped_legs import SteppedLegs

VELOCITY = "velocity_m_per_s"
"""The name of the pusher's speed among the parameters of derivatives."""

MANY = 20_000
"""Pushes from which on a compiled program pays: loading one takes a second or two, as these do."""

_CHUNK = 4096
"""Lanes that go together: their some hundred intermediate columns stay in the second-level
cache."""


def serves(rig: Rig, integrator: Any = None) -> bool:
    """Whether pushes of the rig can be followed in columns: by the closed form or by stepped legs,
    all laws this library's own, as a user's may ask for JAX, and no number of it JAX's."""
    smooth = rig.affine or rig.bends_smoothly
    own = integrator is None or isinstance(integrator, ClosedForm)
    return own and smooth and rig.only_own_laws and not xp.uses_jax(*list_leaves(rig))


def observe_columns(rig: Rig, velocity: Any) -> Observables:
    """What is measured of n pushes at `velocity` [m/s]: columns (n,) of NumPy.

    The velocity and every number of the rig are one value or n; dual numbers among them give the
    derivatives, as dual numbers.
    """
    given = map_tree(_to_column, (rig, velocity))
    n = count_lanes(given)
    parts = []
    for start in range(0, n, _CHUNK):
        stop = min(start + _CHUNK, n)
        part = given if stop - start == n else pick_lanes(given, np.arange(start, stop))
        parts.append(_observe(part, stop - start))
    return join_lanes(parts)


def differentiate_columns(
    rig: Rig, velocity: Any, names: Sequence[str]
) -> tuple[Observables, Observables]:
    """What is measured of n pushes, and its derivatives by parameters of the rig or `VELOCITY`:
    (k, n), a row for each of the k names.

    NaN stands where what is derived does not exist.
    """
    every = {**parameters.values(rig), VELOCITY: velocity}

    def follow(at):
        new = dict(zip(names, at, strict=True))
        speed = new.pop(VELOCITY, velocity)
        return observe_columns(parameters.with_values(rig, new), speed)

    rows = np.eye(len(names))[:, :, None]
    seen, by = differentiate(follow, [every[name] for name in names], list(rows))
    by = map_tree(lambda dx, x: np.broadcast_to(dx, (len(names), len(x))), by, seen)
    exists = np.where(np.isnan(seen.sliding_distance), np.nan, 1.0)
    return seen, by._replace(sliding_distance=by.sliding_distance * exists)


def _observe(given: tuple[Rig, Any], n: int) -> Observables:
    rig, velocity = given
    with np.errstate(all="ignore"):  # what a choice leaves aside may be no number
        legs = ClosedForm() if rig.affine else SteppedLegs()
        push = Push(rig, spread(rig.pusher.speed(velocity), n), legs)
        return spread(observe_segments(push, push.last_state()), n)


def _to_column(leaf):
    return leaf if type(leaf) is Dual else np.asarray(leaf, float)
