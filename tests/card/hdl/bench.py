"""The core on a bench: inputs cycle by cycle, and all that it says held against the reference."""

from __future__ import annotations

import random
from collections.abc import Iterable

from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, Timer

from tests.card.hdl.reference import AROUND, AT_RESET, INPUTS, Core

PERIOD = 10  # [ns]
SETTLED = 3  # cycles after which all has come through the core's pipeline
SIGNED = {"peak_word", "release_count"}
STROBES = {"aReset": 0, "converted": 0, "push_end": 0}


class Bench:
    """Inputs change at the clock's falling edge, half a cycle before they are taken, and outputs
    are looked at there. Strobes last a cycle; all other inputs stay."""

    def __init__(self, dut, seed: int = 0):
        self.dut, self.model = dut, Core()
        self.random = random.Random(seed)
        self.words: list[tuple[int, int]] = []
        self.inputs = dict(INPUTS)
        self.place = 0  # of the encoder, in AROUND
        self._seen, self._since, self._checked = None, 0, False

    async def begin(self) -> None:
        for name, value in self.inputs.items():
            getattr(self.dut, name).value = value
        self.clock = Clock(self.dut.clk, PERIOD, unit="ns")
        self.clock.start(start_high=False)
        await FallingEdge(self.dut.clk)
        await self.cycle(aReset=1)
        await self.idle(6)

    async def cycle(self, *, steps: int = 0, pulse: int = 0, **inputs: int) -> None:
        """One cycle. `steps` of the encoder, of which one or none is legal; `pulse`: a reset that
        comes and goes between two edges of the clock."""
        if steps:
            self.place = (self.place + steps) % 4
            inputs["encoder_a"], inputs["encoder_b"] = AROUND[self.place]
        for name, value in {**STROBES, **inputs}.items():
            if value != self.inputs[name]:
                self.inputs[name] = value
                getattr(self.dut, name).value = value
        if pulse:
            for level in (1, 0):
                await Timer(1, "ns")
                self.dut.aReset.value = level
            self.model.resetting = 3
        self.model.cycle(self.inputs)
        await FallingEdge(self.dut.clk)
        self._look()

    def _look(self) -> None:
        if self.dut.write.value == 1:
            force, position = self.dut.force_word.value, self.dut.position_word.value
            self.words.append((force.to_signed(), position.to_unsigned()))
        if self.model.says != self._seen:
            self._seen, self._since, self._checked = dict(self.model.says), 0, False
        self._since += 1
        if self._since >= SETTLED and not self._checked:
            self.check()
            self._checked = True

    def says(self) -> dict[str, int]:
        """The core's indicators."""
        values = {name: getattr(self.dut, name).value for name in AT_RESET}
        return {
            name: value.to_signed() if name in SIGNED else int(value)
            for name, value in values.items()
        }

    def check(self) -> None:
        assert self.says() == self.model.says
        assert self.words == self.model.words

    async def idle(self, cycles: int, **inputs: int) -> None:
        for _ in range(cycles):
            await self.cycle(**inputs)
            inputs = {}

    async def start(self, **settings: int) -> None:
        """A push, by a `start` that the block diagram takes back."""
        await self.cycle(start=1, **settings)
        await self.cycle(start=0)

    async def end(self) -> None:
        await self.cycle(push_end=1)
        await self.idle(SETTLED)
        self.check()

    async def convert(self, words: Iterable[int], gap: int = 3, turn: float = 0.0) -> None:
        """Conversions every `gap` cycles at least; in each cycle the encoder takes a step with the
        probability |turn|, to its sign's side, and back again as often as `random` has it."""
        for word in words:
            for i in range(self.random.randint(gap, gap + 2)):
                steps = 0
                if self.random.random() < abs(turn):
                    forth = 1 if turn > 0 else -1
                    steps = forth if self.random.random() < 0.8 else -forth  # jitter
                conversion = {"converted": 1, "adc_word": word} if i == 0 else {}
                await self.cycle(steps=steps, **conversion)

    async def push(self, words: Iterable[int], turn: float = 0.3, **settings: int) -> None:
        """A whole push, of which all is checked."""
        await self.start(**settings)
        await self.convert(words, turn=turn)
        await self.end()


def stroke(random: random.Random, n: int = 30, top: int = 4000) -> list[int]:
    """A push's force words: nothing, a hump with noise, nothing."""
    hump = [round(4 * top * i * (n - i) / n**2) for i in range(n)]
    return [word + random.randint(-60, 60) for word in [0] * 4 + hump + [0] * 4]


async def bench_of(dut, seed: int = 0) -> Bench:
    """A core behind its first reset."""
    bench = Bench(dut, seed)
    await bench.begin()
    return bench
