"""A force that rises before t = 0, where nothing should move: its quiet time is not quiet, and what
is taken from there, zero and noise, is wrong."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from difffric.measurements.noise import LONGEST, SHORTEST, Noise, estimate_noise, read_quiet
from difffric.measurements.recordings import Channel

_BLOCKS = 32
"""Block means that the quiet time is seen in: enough to tell when a rise begins."""
_FEW = 8
"""Samples before t = 0 that show a force which is high from the first on."""
_SEEN = 8.0
"""Standard errors that noise, correlated or not, lifts no block's mean above the first one's."""
_LEAST = 0.05
"""A rise below this share of all that the force does is no push: a drift, or a hum."""


class EarlyRise(NamedTuple):
    """A rise of the force before t = 0."""

    height: float
    """of the highest sample above the first ones, or above the last [N]"""
    begin: float
    """when it is first seen [s]"""

    def __str__(self) -> str:
        return (
            f"the force rises by {self.height:.3g} N before t = 0, from {self.begin:.3g} s on: "
            "t = 0 is to be the start of the pusher's motion (`wf_start_offset`)"
        )


def find_early_rise(force: Channel, above_rest: bool = False) -> EarlyRise | None:
    """The rise of a force [N] before t = 0; None: there is none, or too few samples to tell.

    A force that is high from its first sample on rises `above_rest`, if asked for: above its last
    reading, at which a push that rests in contact and a leaking sensor do not end.

    What noise can do is taken from the calmest of three stretches, as the quiet time itself may be
    none: its first quarter, and the recording's last quarter and last eighth.
    """
    quiet = read_quiet(force)
    if len(quiet) < (_FEW if above_rest else 2 * SHORTEST):
        return None
    size = max(1, len(quiet) // _BLOCKS)
    blocks = quiet[: len(quiet) // size * size].reshape(-1, size).mean(axis=1)
    noise = _find_calmest(force, quiet)
    last = float(np.mean(force.read(force.n - max(1, force.n // 8), force.n)))
    low = min(float(blocks[0]), last) if above_rest else float(blocks[0])
    above = blocks - low
    height = float(above.max())
    spread = np.sqrt(2.0) * noise.average(size).level
    ends = np.array([(part.min(), part.max()) for part in force.chunks()])
    if height <= max(_SEEN * spread, _LEAST * (ends[:, 1].max() - ends[:, 0].min())):
        return None
    first = int(np.argmax(above > max(_SEEN * spread, 0.02 * height)))
    highest = float(quiet.max() - low)
    return EarlyRise(highest, -force.dt * (len(quiet) + 1 - first * size))


def _find_calmest(force: Channel, quiet: np.ndarray) -> Noise:
    """The noise of the calmest stretch."""
    last = force.read(max(0, force.n - LONGEST), force.n)
    stretches = [quiet[: len(quiet) // 4], *(last[-(len(last) // share) :] for share in (4, 8))]
    found = [estimate_noise([s]) for s in stretches if len(s) >= SHORTEST]
    return min(found or [estimate_noise([quiet])], key=lambda noise: noise.level)
