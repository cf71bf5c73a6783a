"""The core as docs/card.md says it, in plain Python: a clock cycle's inputs at a time, and without
the core's pipeline. It knows neither the VHDL nor difffric."""

from __future__ import annotations

import math
from fractions import Fraction

AROUND = [(0, 0), (1, 0), (1, 1), (0, 1)]
"""(a, b) of the encoder as its count goes up."""
RESET_LASTS = 3
"""[cycles] with aReset's last one"""
LOWEST, HIGHEST = -(2**15), 2**15 - 1
"""The converter's ends."""
AT_RESET = {
    "done": 0, "samples": 0, "streamed": 0, "overflow": 0, "peak_word": LOWEST, "released": 0,
    "release_sample": 0, "release_count": 0, "encoder_error": 0, "saturated_samples": 0,
}  # fmt: skip
INPUTS = {
    "aReset": 0, "converted": 0, "adc_word": 0, "encoder_a": 0, "encoder_b": 0, "start": 0,
    "push_end": 0, "contact_threshold_word": 74, "contact_hysteresis_word": 110,
    "average_log2": 0, "fifos_have_room": 1,
}  # fmt: skip
"""of a cycle in which nothing is said"""


def rounded_mean(words: list[int]) -> int:
    """A half goes up."""
    return math.floor(Fraction(sum(words), len(words)) + Fraction(1, 2))


class Core:
    """`says` are the indicators, `words` the (force, position) of both FIFOs."""

    def __init__(self):
        self.words: list[tuple[int, int]] = []
        self.count = 0
        # The pins of the last cycles: the decoder is three behind.
        self.pins = [(0, 0)] * 3
        self.resetting = RESET_LASTS
        self.begin(0)
        self.running = False
        self.start_before = 1

    def begin(self, average_log2: int) -> None:
        """A push: nothing is seen of it yet."""
        self.says = dict(AT_RESET)
        self.running, self.contact = True, False
        self.size = 2 ** (average_log2 % 8)
        self.conversions: list[tuple[int, int]] = []

    def cycle(self, x: dict[str, int]) -> None:
        """The inputs of one cycle, and all that follows from them."""
        before, now, _ = self.pins
        turn = (AROUND.index(now) - AROUND.index(before)) % 4
        self.pins = [*self.pins[1:], (x["encoder_a"], x["encoder_b"])]
        if x["aReset"]:
            self.resetting = RESET_LASTS + 1
        if self.resetting:
            self.resetting -= 1
            self.begin(0)
            self.running, self.count, self.start_before = False, 0, 1
            return
        if x["start"] and not self.start_before:
            self.begin(x["average_log2"])
        elif self.running:
            self.push(x, turn)
        self.start_before = x["start"]
        self.count += {0: 0, 1: 1, 2: 0, 3: -1}[turn]

    def push(self, x: dict[str, int], turn: int) -> None:
        if x["converted"]:
            self.conversions.append((x["adc_word"], self.count))
            if len(self.conversions) == self.size:
                self.sample(x)
                self.conversions = []
        self.says["encoder_error"] |= turn == 2
        if x["push_end"]:
            self.running = False
            self.says["done"] = 1

    def sample(self, x: dict[str, int]) -> None:
        words = [word for word, _ in self.conversions]
        force, says = rounded_mean(words), self.says
        _, count = self.conversions[self.size // 2]
        if not x["fifos_have_room"]:
            says["overflow"] = 1
        if not says["overflow"]:
            self.words.append((force, says["samples"] << 32 | count % 2**32))
            says["streamed"] += 1
        says["peak_word"] = max(says["peak_word"], force)
        says["saturated_samples"] += bool({LOWEST, HIGHEST} & set(words))
        low = x["contact_threshold_word"]
        if not self.contact and force >= low + x["contact_hysteresis_word"]:
            self.contact, says["released"] = True, 0
        elif self.contact and force < low:
            self.contact, says["released"] = False, 1
            says["release_sample"], says["release_count"] = says["samples"], count
        says["samples"] += 1
