"""What the core makes of a push, the VHDL and the netlist alike (cocotb; tests/card/test_hdl.py).

Each drives the bench, which holds the core to the reference; what else a test says of itself makes
sure that what it is about has happened.
"""

from __future__ import annotations

import cocotb

from tests.card.hdl.bench import bench_of, stroke
from tests.card.hdl.reference import AT_RESET, HIGHEST, LOWEST, rounded_mean

LOST, MADE = 74, 74 + 110  # the contact's thresholds after a reset


@cocotb.test()
async def nothing_is_taken_before_a_push(dut):
    bench = await bench_of(dut)
    await bench.convert([5000, LOWEST, -5], turn=0.5)
    await bench.cycle(push_end=1)
    await bench.idle(4)
    assert bench.says() == AT_RESET and not bench.words


@cocotb.test()
async def a_word_comes_a_cycle_after_its_conversion_and_the_indicators_two(dut):
    bench = await bench_of(dut)
    await bench.start()
    await bench.cycle(converted=1, adc_word=77, push_end=1)  # of this cycle t, seen in t + 1
    assert dut.write.value == 1 and dut.force_word.value.to_signed() == 77
    assert (dut.samples.value, dut.peak_word.value.to_signed(), dut.done.value) == (0, LOWEST, 0)
    await bench.cycle()
    assert dut.write.value == 0 and dut.done.value == 1
    assert (dut.samples.value, dut.streamed.value, dut.peak_word.value.to_signed()) == (1, 1, 77)


@cocotb.test()
async def an_encoder_s_edge_is_counted_for_a_conversion_three_cycles_later(dut):
    bench = await bench_of(dut)
    await bench.start()
    await bench.cycle(steps=1)
    for i in range(4):
        await bench.cycle(converted=1, adc_word=i)
    await bench.idle(3)
    assert [position % 2**32 for _, position in bench.words] == [0, 0, 1, 1]


@cocotb.test()
async def a_conversion_may_come_in_every_cycle(dut):
    bench = await bench_of(dut, 1)
    for log2 in (0, 1, 3):
        await bench.start(average_log2=log2)
        for _ in range(100):
            word, steps = bench.random.randint(-400, 400), bench.random.choice([0, 1, 1])
            await bench.cycle(converted=1, adc_word=word, steps=steps)
        await bench.end()
    assert len(bench.words) == 100 + 50 + 12


@cocotb.test()
async def pushes_at_random(dut):
    bench = await bench_of(dut, 2)
    losses = 0
    for _ in range(40):
        settings = {
            "contact_threshold_word": bench.random.randint(-200, 900),
            "contact_hysteresis_word": bench.random.randint(0, 300),
            "average_log2": bench.random.choice([0, 0, 1, 2]),
        }
        words = stroke(bench.random, 24, bench.random.choice([400, 4000, 40000]) // 2)
        words += stroke(bench.random, 12, 900)
        words = [max(LOWEST, min(HIGHEST, word)) for word in words]
        await bench.push(words, bench.random.uniform(-0.9, 0.9), **settings)
        losses += bench.says()["released"]
    assert losses > 20


@cocotb.test()
async def two_strokes_in_a_row(dut):
    """Figure III.3: the second is seen as if there had been no first, but from where that ended."""
    bench = await bench_of(dut, 3)
    words = stroke(bench.random)
    seen = []
    for _ in range(2):
        before = bench.model.count
        await bench.push(words, 0.7)
        says = bench.says()
        assert says["released"] and says["release_count"] > before
        seen.append({name: says[name] for name in says if name != "release_count"})
    assert seen[0] == seen[1]
    numbers = [position >> 32 for _, position in bench.words]
    assert numbers == 2 * list(range(len(words)))


@cocotb.test()
async def a_jittering_edge_is_counted_forth_and_back(dut):
    bench = await bench_of(dut, 4)
    await bench.start()
    for burst in (1, 2, 3, 5, 30):
        for steps in burst * [1] + burst * [-1] + [1, -1] * burst:
            await bench.cycle(steps=steps)
        await bench.idle(3)
        await bench.cycle(converted=1)
    assert bench.model.count == 0
    for turn in (1.0, -1.0, 0.5, -0.5):
        await bench.convert(range(60), turn=turn)
    await bench.end()
    assert [position % 2**32 for _, position in bench.words[:5]] == 5 * [0]
    assert any(position % 2**32 > 2**31 for _, position in bench.words), "no negative count"
    assert not bench.says()["encoder_error"]


@cocotb.test()
async def an_illegal_transition_sets_the_flag_and_leaves_the_count(dut):
    bench = await bench_of(dut, 5)
    for place in range(4):
        await bench.start()
        await bench.convert([0, 0], turn=0)
        before = bench.model.count
        await bench.cycle(steps=2)
        await bench.convert([0, 0], turn=0)
        assert bench.says()["encoder_error"] == 1 and bench.model.count == before
        await bench.cycle(steps=1)
        await bench.idle(4)
        assert bench.model.count == before + 1, place
        await bench.end()
    # Between pushes it is not of a push, and the next push begins without.
    await bench.start()
    await bench.end()
    await bench.cycle(steps=2)
    await bench.idle(5)
    assert bench.says()["encoder_error"] == 0


@cocotb.test()
async def the_peak_is_the_largest_of_equal_and_of_negative_words(dut):
    bench = await bench_of(dut, 6)
    for words in (
        [5, 9, 9, 3, 9],
        [-7, -3, -3, -20000],
        [LOWEST, LOWEST],
        [LOWEST, LOWEST + 1, LOWEST],
        [HIGHEST, HIGHEST, 0],
        [-1, 0, -1],
        [],
    ):
        await bench.push(words)
        assert bench.says()["peak_word"] == max([LOWEST, *words])


@cocotb.test()
async def contact_is_made_at_the_sum_and_lost_below_the_threshold(dut):
    bench = await bench_of(dut)
    for words, lost_at in (
        ([0, MADE - 1, 0], None),
        ([0, MADE, LOST, LOST - 1, 0], 3),
        ([0, MADE, LOST - 1, MADE - 1, 0], 2),
        ([MADE, 0, MADE, 0, 0], 3),
        ([MADE, 0, MADE, LOST], None),
        ([LOST - 1, LOST, LOWEST], None),
    ):
        await bench.push(words)
        assert bench.says()["released"] == (lost_at is not None)
        if lost_at is not None:
            assert bench.says()["release_sample"] == lost_at


@cocotb.test()
async def thresholds_near_the_converter_s_ends_do_not_wrap(dut):
    bench = await bench_of(dut, 7)
    ends = [LOWEST, LOWEST + 1, -1, 0, 1, HIGHEST - 1, HIGHEST]
    for low in ends:
        for hysteresis in (-5, 0, 1, HIGHEST, LOWEST):
            words = [*ends, *reversed(ends), low, max(low - 1, LOWEST)]
            settings = {"contact_threshold_word": low, "contact_hysteresis_word": hysteresis}
            await bench.start(**settings)
            await bench.convert(words, gap=2)
            await bench.end()
            if hysteresis == HIGHEST and low > 0:  # no word is so large
                assert not bench.says()["released"] and not bench.says()["release_sample"]


@cocotb.test()
async def saturated_is_either_end_and_nothing_beside_it(dut):
    bench = await bench_of(dut)
    await bench.push([LOWEST, LOWEST + 1, HIGHEST - 1, HIGHEST, HIGHEST, 0])
    assert bench.says()["saturated_samples"] == 3


@cocotb.test()
async def each_average_is_the_rounded_mean_of_its_conversions(dut):
    bench = await bench_of(dut, 8)
    for log2 in range(8):
        n = 2**log2
        samples = [
            [LOWEST] * n,
            [HIGHEST] * n,
            [0] * (n - n // 2) + [1] * (n // 2),  # a half
            [0] * (n - n // 2) + [-1] * (n // 2),
            [-1] * (n - n // 2 - 1) + [0] * (n // 2 + 1),
            [bench.random.randint(LOWEST, HIGHEST) for _ in range(n)],
            [bench.random.randint(-3, 3) for _ in range(n)],
        ]
        del bench.words[:], bench.model.words[:]
        unfinished = [HIGHEST] * (n - 1)  # of which no sample comes
        await bench.start(average_log2=log2)
        # Changed within the push, which keeps what it began with.
        await bench.cycle(average_log2=7 - log2)
        words = [word for sample in [*samples, unfinished] for word in sample]
        await bench.convert(words, gap=1, turn=0.8)
        await bench.end()
        assert [word for word, _ in bench.words] == [rounded_mean(one) for one in samples]
        assert bench.says()["samples"] == len(samples)


@cocotb.test()
async def the_count_of_an_average_is_that_of_its_middle_conversion(dut):
    bench = await bench_of(dut)
    for log2 in range(6):
        n = 2**log2
        await bench.cycle(aReset=1)
        await bench.idle(6)
        del bench.words[:], bench.model.words[:]
        await bench.start(average_log2=log2)
        for _ in range(3 * n):  # a count a conversion, from 1 on
            await bench.cycle(steps=1)
            await bench.idle(3)
            await bench.cycle(converted=1)
        await bench.end()
        assert [position % 2**32 for _, position in bench.words] == [
            1 + i * n + n // 2 for i in range(3)
        ]


@cocotb.test()
async def one_saturated_conversion_saturates_its_average(dut):
    bench = await bench_of(dut)
    for log2 in (1, 2, 3):
        n = 2**log2
        for at in range(n):
            one = [0] * n
            one[at] = HIGHEST if at % 2 else LOWEST
            await bench.push([0] * n + one + [0] * n, average_log2=log2)
            assert bench.says()["saturated_samples"] == 1
        await bench.push([0] * (n - 1) + [HIGHEST - 1] * 2, average_log2=log2)
        assert bench.says()["saturated_samples"] == 0


@cocotb.test()
async def a_full_fifo_closes_both_until_the_next_push(dut):
    bench = await bench_of(dut, 9)
    for full_at, open_at in ((0, 3), (5, 6), (10, 21), (19, 30)):
        words = stroke(bench.random, 12)  # 20 of them
        first = len(bench.words)
        await bench.start()
        for i, word in enumerate(words):
            await bench.convert([word], turn=0.4)
            if i + 1 in (full_at, open_at):
                await bench.cycle(fifos_have_room=int(i + 1 == open_at))
            if i == 0 and full_at == 0:
                await bench.cycle(fifos_have_room=0)
        await bench.end()
        await bench.cycle(fifos_have_room=1)
        says = bench.says()
        assert (says["samples"], says["overflow"]) == (20, 1)
        assert says["streamed"] == len(bench.words) - first == max(full_at, 1)
        assert says["peak_word"] == max(words)
    await bench.push(stroke(bench.random))
    assert not bench.says()["overflow"] and bench.says()["streamed"] == bench.says()["samples"]


@cocotb.test()
async def room_is_asked_for_only_where_a_word_comes(dut):
    bench = await bench_of(dut)
    await bench.start(average_log2=1)
    for word in range(8):
        await bench.cycle(converted=1, adc_word=word, fifos_have_room=word % 2)
        await bench.idle(2, fifos_have_room=0)
    await bench.end()
    assert bench.says()["streamed"] == 4 and not bench.says()["overflow"]
