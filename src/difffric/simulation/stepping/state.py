"""What the loop over the steps of a push carries from step to step."""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Float, Int

from difffric.simulation.dynamics import Course, PhasePoint


class LoopState(NamedTuple):
    """Where a push stands, and what has been counted and measured of it."""

    s: PhasePoint
    course: Course
    h: Float[Array, ""]
    """the next free step [s]"""
    target: Int[Array, ""]
    """the event that the next step is to end on, or `Event.NONE`"""
    h_target: Float[Array, ""]
    """how far that is [s]"""
    contacts: Int[Array, ""]
    """contacts so far, that at the start included"""
    sticks: Int[Array, ""]
    """times that the part was held at rest"""
    lost: Bool[Array, ""]
    """whether contact has ever been lost"""
    lost_moving: Bool[Array, ""]
    """whether it was lost while the pusher moved, the last time"""
    t_lost: Float[Array, ""]
    """when contact was lost [s], the last time"""
    x_lost: Float[Array, ""]
    """the part's position where it was lost [m], the last time"""
    peak: Float[Array, ""]
    """the largest contact force [N]"""
    peak_contact: Int[Array, ""]
    """the contact in which it fell"""
    summited: Bool[Array, ""]
    """whether the force's highest point in this mode has been passed"""
    slowed: Bool[Array, ""]
    """whether the part's slowest point in this mode has been passed"""
    rebounds: Int[Array, ""]
    """rebounds that ended in contact"""
    halts: Int[Array, ""]
    """times that the part came to rest"""
    endless: Bool[Array, ""]
    """whether the push goes on for ever"""
    over: Bool[Array, ""]
    """whether nothing more will happen (or more than is followed)"""
    steps: Int[Array, ""]
    """steps tried"""
    strides: Int[Array, ""]
    """steps accepted"""
    lost_track: Bool[Array, ""]
    """whether it could not be followed: a law gave no number, or steps shrank to nothing"""
    stuck_first: Bool[Array, ""]
    """whether static friction held the part at the start"""
    sensed: Any
    """what the sensors have seen, where they see more than the plain peak and release"""
