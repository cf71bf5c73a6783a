"""Where a push stands while it is followed, and what has been counted and measured of it."""

from __future__ import annotations

from typing import Any, NamedTuple

from jax import Array

from difffric.simulation.dynamics import Course, Point


class March(NamedTuple):
    """Where a push stands, and what has been counted and measured of it."""

    s: Point
    course: Course
    h: Array
    """the next free step [s]"""
    target: Array
    """the event that the next step is to end on, or -1"""
    h_target: Array
    contacts: Array
    sticks: Array
    lost: Array
    lost_moving: Array
    x_lost: Array
    peak: Array
    peak_contact: Array
    summited: Array
    slowed: Array
    rebounds: Array
    halts: Array
    endless: Array
    over: Array
    steps: Array
    strides: Array
    """steps accepted"""
    lost_track: Array
    stuck_first: Array
    sensed: Any
    """what the sensors have seen, where they see more than the plain peak and release"""
