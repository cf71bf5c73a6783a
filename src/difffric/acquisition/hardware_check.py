"""What the card itself saw of a push, held against the words that were recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LOWEST, HIGHEST = -(2**15), 2**15 - 1
"""The converter's ends."""
_SHORTEST = 16  # samples from which on a constant word is no chance


@dataclass(frozen=True)
class Hardware:
    """The card's own peak hold, contact-loss latch and error flags for one push."""

    peak_word: int
    """the largest force word: of single samples, and so too high by the noise"""
    released: bool
    release_sample: int
    """number of the first sample after the last loss of contact, where there was one"""
    release_count: int
    """the encoder's count there"""
    encoder_error: bool
    saturated_samples: int
    overflow: bool
    agrees: bool | None
    """whether the recorded words say the same; None: some were lost, and nothing contradicts"""
    problems: tuple[str, ...] = ()
    """where they do not, a sentence each"""


class Watch:
    """Peak, contact and saturation of the recorded words, as they come.

    Contact is made at `high` and lost below `low`.
    """

    def __init__(self, low: int, high: int):
        self._low, self._high = low, high
        self.n = 0
        self._most, self._least = LOWEST, HIGHEST
        self._contact = False
        self._loss: tuple[int, int] | None = None
        self._saturated = 0

    def add(self, force: NDArray[np.int16], count: NDArray[np.int32]) -> None:
        """The next samples."""
        if not len(force):
            return
        most, least = int(force.max()), int(force.min())
        if most == HIGHEST or least == LOWEST:
            self._saturated += int(np.count_nonzero((force == HIGHEST) | (force == LOWEST)))
        if most >= self._high if not self._contact else least < self._low:
            self._follow(force, count)
        self._most, self._least = max(self._most, most), min(self._least, least)
        self.n += len(force)

    def _follow(self, force: NDArray, count: NDArray) -> None:
        """Contact made and lost in these samples."""
        made = force >= self._high
        telling = np.flatnonzero(made | (force < self._low))  # the others change nothing
        contact = made[telling]
        before = np.concatenate([[self._contact], contact[:-1]])
        losses = telling[before & ~contact]
        self._contact = bool(contact[-1])
        if len(losses):
            self._loss = self.n + int(losses[-1]), int(count[losses[-1]])

    def find_fault(self, seen: Mapping[str, int]) -> str:
        """Why the samples of this push are not to be trusted, by them and by what the card saw;
        empty where they are."""
        faults = []
        if saturated := max(int(seen["saturated_samples"]), self._saturated):
            faults.append(f"saturated: {saturated} samples at an end of the converter")
        if seen["encoder_error"]:
            faults.append("encoder error: the counts are off from there on")
        if self.n >= _SHORTEST and self._most == self._least:
            faults.append(f"dead sensor: each of {self.n} force words is {self._most}")
        return "; ".join(faults)

    def compare(self, seen: Mapping[str, int], lost: int) -> Hardware:
        """What the card saw, as its registers say it, and whether that is what was recorded; of
        the samples taken, `lost` did not come."""
        peak, released = int(seen["peak_word"]), bool(seen["released"])
        loss = int(seen["release_sample"]), int(seen["release_count"])
        problems = []
        if peak < self._most or (peak != self._most and not lost):
            problems.append(f"the card held a peak word of {peak}, the largest one is {self._most}")
        if not lost:
            mine = self._loss is not None and not self._contact
            if released != mine:
                words = ("in contact", "released")
                problems.append(f"the card says {words[released]}, the force {words[mine]}")
            elif released and loss != self._loss:
                problems.append(
                    "the card latched (sample, count) {} {}, the force was lost at {} {}".format(
                        *loss, *(self._loss or ())
                    )
                )
            # More where the card averages: a conversion at an end does not show in its mean.
            if (counted := int(seen["saturated_samples"])) < self._saturated:
                problems.append(
                    f"the card counted {counted} saturated samples of {self._saturated}"
                )
        return Hardware(
            peak_word=peak,
            released=released,
            release_sample=loss[0],
            release_count=loss[1],
            encoder_error=bool(seen["encoder_error"]),
            saturated_samples=int(seen["saturated_samples"]),
            overflow=bool(seen["overflow"]),
            agrees=False if problems else (None if lost else True),
            problems=tuple(problems),
        )
