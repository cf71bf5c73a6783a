"""Equation (2), the force balance of part and pusher. It is written here and nowhere else.

The forces in it are laws of their own: `contact` says what the tip does to the part, `friction`
what the rails do, and `rig.Rig` puts them together for each mode of a push.
"""

from __future__ import annotations

from typing import Any


def accelerate(F_contact: Any, F_friction: Any, F_slope: Any, mass: Any) -> Any:
    """Return the part's acceleration x'' [m/s^2] from the forces on it [N] and its mass [kg].

    m x'' = b max(y' - x', 0) + k max(y - x, 0) - F(t), solved for x''. `F_contact` stands for the
    first two terms, `F_friction` for F(t), and `F_slope` is what gravity holds against the push.

    These are the physical signs: the paper prints -F(t) alone on the right and the contact on the
    left, which would pull the part away from the push.
    """
    return (F_contact - F_friction - F_slope) / mass
