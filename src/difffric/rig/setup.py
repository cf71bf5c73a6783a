"""A set-up: a rig, the scatter of mu_s, and what is known of its numbers; and the check of a rig.

`setup_toml` reads and writes a set-up as a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from difffric.compute.number_tree import is_traced
from difffric.errors import InputError
from difffric.rig.quantities import OF_EFFECTS, PLAIN, STROKE, effects_of, has_plain_law
from difffric.rig.rig import Rig


@dataclass(frozen=True)
class Extras:
    """What a number's table says beside its value, in the file's own unit, which differs from
    SI only where its name says so (`pusher.stroke_mm`). None: not said."""

    standard_error: float | None = None
    free: bool | None = None
    lower: float | None = None
    upper: float | None = None


@dataclass(frozen=True)
class Setup:
    """What a setup.toml says. `extras` has an entry for each number given as a table."""

    rig: Rig
    mu_s_scatter: float | None = None
    """relative standard deviation of mu_s from push to push; None: not known"""
    extras: Mapping[str, Extras] = field(default_factory=dict)
    text: str = field(default="", compare=False, repr=False)
    """of the file that it was read from: a new file keeps its comments and layout"""
    channels: Mapping[str, str] = field(default_factory=dict)
    """what files of data call a channel or column, by our name, such as Kraft for force"""
    recorded_motion: bool = False
    """whether the recorded channel `pusher` of each push is its tip's motion, in place of its speed
    and the stroke"""


def refuse_recorded_motion(setup: Setup, what: str) -> None:
    """Raise `InputError` where a set-up asks for the recorded pusher; `what` says of what has none:
    a table has no channel pusher."""
    if setup.recorded_motion:
        raise InputError(f'{what}, and the set-up has [pusher] motion = "recorded"')


def check_rig(rig: Rig) -> Rig:
    """The rig itself, or an `InputError` that names all its values out of range.

    It sees the mass, the numbers of equations (1) and (2), the stroke and the effects' numbers,
    element by element; other laws, and values that JAX is tracing, pass.
    """
    problems = []
    for q in (*PLAIN, *(q for found in effects_of(rig) for q in OF_EFFECTS[found])):
        if q.section in ("force_sensor", "probe") or not has_plain_law(rig, q.section):
            continue
        value = q.of(Setup(rig))
        if q.key == "mu_s_scatter" or is_traced(value) or (q is STROKE and value is None):
            continue
        x = np.asarray(value)
        if x.dtype.kind not in "iuf":
            problems.append(f"{q.attribute}: {q.range.describe_expected(0)}, got {value!r}")
            continue
        x = np.asarray(q.of_rig(x))
        good = q.range.allows(x) | ((q is STROKE) & (x == np.inf))  # which means none
        if not good.all():
            at = np.unravel_index(np.argmin(good), x.shape)
            where = f" at index {', '.join(map(str, at))}" if x.ndim else ""
            problems.append(
                f"{q.attribute}: {q.range.describe_expected(x[at])}, got {x[at]}{where}"
            )
    if problems:
        raise InputError("\n".join(problems))
    return rig
