"""What can happen in a push: its modes, the events between them, how it went, and why something of
it may not exist.

When an event comes is found by `closed_form`, as the release is in `follow_rebounding`, and for
any laws by `stepping.event_location`. Every program of the simulation works with these numbers;
where a person reads one, its member's text says it. A code from a compiled program becomes a member
by `Regime(int(code))`.
"""

from __future__ import annotations

from enum import IntEnum

MAX_CONTACTS = 16
"""A push of more contacts is not followed to its end, here and in the tests' own references."""
MAX_CYCLES = 1000
"""Turns through the modes after which a push is given up; one of a single contact takes one."""


class _Code(IntEnum):
    """A number with the sentence that a person reads for it."""

    text: str

    def __new__(cls, code: int, text: str = ""):
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        return member


class Mode(_Code):
    """What the part does between two events. w is the tip's speed relative to the part's."""

    STUCK = 0, "friction holds the part at rest, in contact or not"
    CLOSING = 1, "the tip pushes the part and closes in on it (w >= 0)"
    REBOUNDING = 2, "the tip pushes the part, which recedes from it (w < 0)"
    FREE = 3, "the part slides without contact"


class Event(_Code):
    """What ends a mode, or else changes how a push goes on; u is the part's speed.

    The order counts: of two events at the same time the step-by-step integrator takes the first.
    """

    NONE = -1, "nothing comes"
    TURN = 0, "tip and part have the same speed (w = 0)"
    BREAKAWAY = 1, "the contact force reaches static friction"
    HALT = 2, "the part comes to rest (u = 0)"
    CONTACT = 3, "contact is lost (a release) or begins (a catch), as the mode before it says"
    STOP = 4, "the pusher's command stops"
    LOAD_JUMP = 5, "the part comes to the place where the load jumps"
    FORCE_PEAK = 6, "the contact force is highest"
    SLOWEST = 7, "the part is slowest"
    CORNER = 8, "the pusher's speed has a corner: where its ramp ends, or a piece of its motion"
    RELEASE = 9, "contact is lost"
    CATCH = 10, "the part comes into contact again"


class Regime(_Code):
    """How a push went."""

    NO_MOTION = 0, "static friction held the part to the end"
    PUSHED_TO_REST = 1, "the part moved, and came to rest in contact with the tip"
    RELEASED_BY_REBOUND = 2, "the part left the tip while the pusher moved"
    RELEASED_AT_STOP = 3, "the part left the tip once the pusher had stopped"

    @property
    def word(self) -> str:
        """The word that stands in `result.json`."""
        return self.name.lower()


class Reason(_Code):
    """Why the sliding distance, or more of a push, does not exist."""

    OK = 0, "it exists"
    RESTS_IN_CONTACT = 1, "rests in contact"
    NEVER_RELEASED = 2, "never released: without a stroke the pusher goes on for ever"
    NEVER_RESTS = 3, "never comes to rest"
    TOO_MANY_CONTACTS = 4, f"more than {MAX_CONTACTS} contacts"
    TOO_MANY_CYCLES = 5, f"more than {MAX_CYCLES} cycles in contact"
    NOT_FOLLOWED = (
        6,
        "could not be integrated: more steps were needed than allowed, or a law gave no number",
    )


def explain(reason: int) -> str | None:
    """The text of a reason, by its code; None where nothing is missing."""
    return None if reason == Reason.OK else Reason(int(reason)).text


def word_reason(reason: str) -> str:
    """A reason as `result.json` has it, in words for a person."""
    words = "the part stayed in contact, so there is no d"
    return reason.replace(Reason.RESTS_IN_CONTACT.text, words)
