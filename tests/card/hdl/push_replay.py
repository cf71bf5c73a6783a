"""A push's conversions and encoder counts through the core (cocotb): `REPLAY` names the folder with
`push.npz`, and takes what the core says, `core.json`."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cocotb
import numpy as np

from tests.card.hdl.bench import SETTLED, Bench

FOLDER = Path(os.environ["REPLAY"])


@cocotb.test()
async def replay(dut):
    """A clock cycle for each of the encoder's edges, and as few beside them as the core needs."""
    bench = Bench(dut)
    await bench.begin()
    push = np.load(FOLDER / "push.npz")
    at, started = 0, False

    async def turn_to(count: int) -> None:
        nonlocal at
        forth = 1 if count > at else -1
        while at != count:
            at += forth
            await bench.cycle(steps=forth)
        await bench.idle(SETTLED)  # the decoder is as far behind

    counts, words = push["counts"].tolist(), push["words"].tolist()
    for count, word in zip(counts, words, strict=True):
        await turn_to(count)
        if not started:  # at wherever the encoder stands
            await bench.start(average_log2=int(push["average_log2"]))
            started = True
        await bench.cycle(converted=1, adc_word=word)
    await bench.end()
    told = {"words": bench.words, "says": bench.says()}
    (FOLDER / "core.json").write_text(json.dumps(told))
