"""What a monitor remembers: the pushes it took, the cells they fall in, the alarms it raised."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Channel, Recording
from difffric.monitoring.change_cause import After, Candidate, Setting, candidates
from difffric.monitoring.readings import Reader


@dataclass
class Cell:
    """Pushes that one model error is shared by: of one part at one setting."""

    part: str
    velocity: float
    mass: float | None
    stroke: float | None
    measured: str
    """`both`, `force` or `distance`"""
    sigma: list[float | None]
    """errors of F_p [N] and d [m] of its last push; None: not measured"""


@dataclass
class Seen:
    """One push as the monitor took it, SI units; None: not said, or not to be had."""

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
    """its own"""
    standard_error: float | None = None
    """of it, by the sensors alone"""
    state: float | None = None
    """mu_s of its part at the part's first speed, after this push"""
    state_se: float | None = None
    contrast: float | None = None
    """what mu_s cannot explain, in standard deviations of the noise"""
    z: list[float | None] = field(default_factory=lambda: [None, None])
    """mu_s and contrast against the pushes before: standard normal while nothing changes"""
    log_evidence: float | None = None
    """logarithm of the statistic over its threshold: an alarm from 0 on"""
    log_evidence_by: list[float | None] = field(default_factory=list)
    """each direction's share of it (`evidence.DIRECTIONS`)"""
    alarm: bool = False
    cell: str | None = None
    log_mu_s: float | None = None
    h: float | None = None
    squares: list[float] = field(default_factory=lambda: [0.0, 0.0])
    taken: list[bool] = field(default_factory=lambda: [False, False])


@dataclass
class Alarm:
    """Something has changed."""

    push: int
    """number of the push that raised it"""
    change: int
    """of the first push after the change, as estimated"""
    kind: str
    """`step`, `drift`, or `step or drift`"""
    direction: str
    """where most of the evidence is (`evidence.DIRECTIONS`)"""
    settings: dict[str, list[Any]]
    """cell -> `Setting` before the change"""
    after: list[list[Any]]
    """cell, log mu_s, h, contrast of each push from the change on"""

    def causes(self, reader: Reader) -> list[Candidate]:
        """What may have changed, by all pushes since; the likeliest first."""
        known = [k for k in dict.fromkeys(a[0] for a in self.after) if k in self.settings]
        return candidates(
            reader,
            [Setting(*_numbers(self.settings[k])) for k in known],
            [After(known.index(k), *_numbers(x)) for k, *x in self.after if k in known],
        )


def content_of(push: Pushes, *more: str) -> str:
    """What identifies the contents of a push, as text."""
    columns = ("velocity", "peak_force", "sliding_distance", "peak_force_se",
               "sliding_distance_se", "mass", "stroke", "order")  # fmt: skip
    said = [repr(float(getattr(push, name)[0])) for name in columns]
    return _digest(["push", *said, push.condition[0], *more])


def content_of_recording(recording: Recording) -> str:
    """The same of a recording: all of its samples, and what is said of it."""
    r, digest = recording, hashlib.sha256()
    for channel in (r.force, r.position, r.pusher):
        for samples in channel.chunks() if isinstance(channel, Channel) else ():
            digest.update(np.ascontiguousarray(samples, float).tobytes())
    said = (r.velocity, r.mass, r.stroke, r.order)
    return _digest(["recording", digest.hexdigest(), *(repr(float(x)) for x in said), r.condition])


def _digest(words: Iterable[str]) -> str:
    return hashlib.sha256("\0".join(words).encode()).hexdigest()[:20]


def _numbers(saved: Iterable[Any]) -> list[Any]:
    """None as what the number is not: infinite for an error, else NaN."""
    out = []
    for x in saved:
        if isinstance(x, list):
            out.append(tuple(math.inf if v is None else v for v in x))
        else:
            out.append(math.nan if x is None else x)
    return out
