"""A latch of the force: where the part was when the force first fell through a threshold."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from difffric.compute import arrays as xp
from difffric.rig.number import Number

if TYPE_CHECKING:
    from jaxtyping import Array, Bool, Float


class ForceFall(NamedTuple):
    """How the contact force goes along one leg."""

    first: Number
    """at its start [N]"""
    last: Number
    """at its end [N]"""
    time: Number
    """when it falls through the threshold within the leg [s]; infinite: it does not"""


class ForceLatch(NamedTuple):
    """What the latch has seen so far."""

    armed: Bool[Array, ""]
    """whether the force was not below the threshold, the last time"""
    closed: Bool[Array, ""]
    """whether it has ever fallen through it"""
    x: Float[Array, ""]
    """where the part was then [m]"""

    def follow(self, level: Number, fall: ForceFall, x_first: Number, x_fall: Number) -> ForceLatch:
        """The latch after one more leg, which begins with the part at x_first [m]; it is at x_fall
        where the force falls through the level [N] within the leg. A jump of the force between two
        legs is a fall too."""
        jumps = self.armed & (fall.first < level)
        x = xp.where(jumps, x_first, x_fall)
        now = (jumps | xp.isfinite(fall.time)) & ~self.closed
        armed = xp.asarray(fall.last >= level)
        return ForceLatch(armed, self.closed | now, xp.where(now, x, self.x))
