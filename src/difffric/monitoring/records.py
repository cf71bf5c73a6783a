"""Records: what a monitor remembers of each push, the cells that pushes fall in, and digests by
which it recognises a push that was counted before."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Channel, Recording

NUMBERS = (
    "velocity",
    "peak_force",
    "sliding_distance",
    "peak_force_se",
    "sliding_distance_se",
    "mass",
    "stroke",
    "order",
)
"""The numbers that may be said of a push, by the names of `Pushes`."""


@dataclass
class Cell:
    """A part at one setting (speed, stroke, what is measured). Its pushes share one error of the
    model, so they have a mean of their own."""

    part: str
    velocity: float
    mass: float | None
    stroke: float | None
    measured: str
    """`both`, `force` or `distance`"""
    sigma: list[float | None]
    """errors of F_p [N] and d [m] of its last push; None: not measured"""


@dataclass
class PushRecord:
    """One push as the monitor took it, in SI units; None: not said, or not to be had."""

    number: int
    """from 1, over all that were ever counted"""
    source: str
    name: str
    velocity: float
    condition: str
    mass: float | None
    stroke: float | None
    order: float | None
    peak_force: float | None
    sliding_distance: float | None
    reason: str | None = None
    """why it could not be identified"""
    mu_s: float | None = None
    """the push's own"""
    standard_error: float | None = None
    """of mu_s, by the sensors alone"""
    state: float | None = None
    """mu_s of its part at the part's first speed, after this push"""
    state_se: float | None = None
    """standard error of `state`"""
    contrast: float | None = None
    """what mu_s cannot explain, in standard deviations of the noise"""
    z: list[float | None] = field(default_factory=lambda: [None, None])
    """mu_s and contrast against the pushes before: standard normal while nothing changes"""
    log_evidence: float | None = None
    """logarithm of the statistic over its threshold: there is an alarm from 0 on"""
    log_evidence_by: list[float | None] = field(default_factory=list)
    """each direction's share of it (`shiryaev_roberts.DIRECTIONS`)"""
    alarm: bool = False
    """whether the push raised one"""
    cell: str | None = None
    """its key among the monitor's cells"""
    log_mu_s: float | None = None
    h: float | None = None
    """expected variance of `log_mu_s`, but for the cell's factor phi"""
    squares: list[float] = field(default_factory=lambda: [0.0, 0.0])
    """what the push added to the spreads of friction and contrast"""
    taken: list[bool] = field(default_factory=lambda: [False, False])
    """whether the push went into the means of friction and contrast"""


def digest_push(push: Pushes, *more: str) -> str:
    """Digest of what is said of one push and of `more`."""
    said = [repr(float(getattr(push, name)[0])) for name in NUMBERS]
    return _digest(["push", *said, push.condition[0], *more])


def digest_recording(recording: Recording) -> str:
    """Digest of a recording: all of its samples, and what is said of it."""
    r, digest = recording, hashlib.sha256()
    for channel in (r.force, r.position, r.pusher):
        for samples in channel.chunks() if isinstance(channel, Channel) else ():
            digest.update(np.ascontiguousarray(samples, float).tobytes())
    said = (r.velocity, r.mass, r.stroke, r.order)
    return _digest(["recording", digest.hexdigest(), *(repr(float(x)) for x in said), r.condition])


def _digest(words: Iterable[str]) -> str:
    return hashlib.sha256("\0".join(words).encode()).hexdigest()[:20]
