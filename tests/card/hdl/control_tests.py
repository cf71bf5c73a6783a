"""Starts, ends and resets that come at any time, of the VHDL and the netlist alike (cocotb;
tests/card/test_hdl.py)."""

from __future__ import annotations

import cocotb
from cocotb.triggers import Timer

from tests.card.hdl.bench import bench_of
from tests.card.hdl.reference import AT_RESET, HIGHEST, LOWEST


@cocotb.test()
async def a_start_within_a_push_begins_anew_at_once(dut):
    bench = await bench_of(dut, 10)
    await bench.start()
    await bench.convert([HIGHEST, 500, 0], turn=0.5)
    await bench.cycle(steps=2)
    await bench.idle(3)
    await bench.cycle(fifos_have_room=0)
    await bench.convert([3000, 0])
    says = bench.says()
    flags = says["released"], says["encoder_error"], says["overflow"], says["saturated_samples"]
    assert flags == (1, 1, 1, 1)
    await bench.cycle(converted=1, adc_word=900, fifos_have_room=1)
    # A conversion in the cycle of the start belongs to no push; that before it to the last one.
    await bench.cycle(start=1, converted=1, adc_word=999)
    await bench.idle(4)
    assert bench.says() == AT_RESET
    await bench.convert([-5, 6])
    await bench.idle(10)  # start is still true, and begins nothing more
    await bench.end()
    assert bench.says()["samples"] == 2 and bench.says()["peak_word"] == 6
    await bench.cycle(start=0)
    # An unfinished average is no part of the next push.
    await bench.start(average_log2=2)
    await bench.convert([LOWEST, HIGHEST, 7])
    await bench.push([1, 2, 3, 4], average_log2=2)
    assert bench.says()["saturated_samples"] == 0 and bench.says()["peak_word"] == 3


@cocotb.test()
async def an_end_and_a_start_in_one_cycle_are_of_two_pushes(dut):
    bench = await bench_of(dut)
    await bench.start()
    await bench.convert([500, 0])
    await bench.cycle(start=1, push_end=1)
    await bench.idle(4, start=0)
    assert not bench.says()["done"]
    await bench.convert([3])
    await bench.cycle(push_end=1)
    await bench.cycle(start=1)  # a cycle later
    await bench.idle(4, start=0)
    assert not bench.says()["done"]
    await bench.convert([4, 5])
    await bench.end()
    assert bench.says()["done"] and bench.says()["samples"] == 2
    await bench.convert([1000])
    await bench.cycle(push_end=1)
    await bench.idle(4)
    assert bench.says()["samples"] == 2


@cocotb.test()
async def a_reset_at_any_moment_leaves_nothing(dut):
    bench = await bench_of(dut, 11)
    for moment in range(40):
        await bench.start(average_log2=moment % 3)
        for i in range(moment):
            word = (0, 500, HIGHEST, 0)[i % 4]
            room, steps = int(i < 20), 2 if i == 12 else 1
            # A sample's last conversion, its word, its taking and the end: each in some moment's
            # last cycle.
            await bench.cycle(
                converted=1, adc_word=word, fifos_have_room=room, steps=steps, push_end=int(i == 33)
            )
        if moment % 2:
            await bench.cycle(pulse=1, fifos_have_room=1)
        else:
            await bench.idle(1 + moment % 3, aReset=1, fifos_have_room=1)
        await bench.idle(7)
        assert bench.says() == AT_RESET and bench.model.count == 0
        await bench.push([400, 0], turn=0, average_log2=0)
        assert [position for _, position in bench.words[-2:]] == [0, 1 << 32]
        assert bench.says()["released"]


@cocotb.test()
async def pins_that_are_high_at_a_reset_are_no_edges(dut):
    bench = await bench_of(dut)
    for place in range(4):
        while bench.place != place:
            await bench.cycle(steps=1)
        await bench.start()
        await bench.cycle(pulse=1)
        await bench.idle(2)
        await bench.start()  # as early as one is taken
        await bench.convert([0, 0, 0])
        await bench.end()
        assert bench.model.count == 0 and not bench.says()["encoder_error"]


@cocotb.test()
async def a_start_that_outlasts_a_reset_begins_no_push(dut):
    bench = await bench_of(dut)
    await bench.cycle(start=1)
    await bench.idle(2, aReset=1)
    await bench.convert([500, 0, 0])
    assert bench.says() == AT_RESET
    await bench.cycle(start=0)
    await bench.push([500, 0])
    assert bench.says()["samples"] == 2


@cocotb.test()
async def a_reset_while_the_clock_stands_still_is_not_lost(dut):
    bench = await bench_of(dut)
    await bench.start()
    await bench.convert([500, 0, HIGHEST])
    bench.clock.stop()
    await Timer(95, "ns")
    for level in (1, 0):
        dut.aReset.value = level
        await Timer(40, "ns")
    bench.model.resetting = 3
    bench.clock.start(start_high=False)
    await Timer(1, "ns")
    await bench.idle(6)
    assert bench.says() == AT_RESET
