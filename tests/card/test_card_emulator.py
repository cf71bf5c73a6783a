"""The real nifpga package against a card emulated below it, and recordings made through both."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import nifpga
import numpy as np
import pytest
from nifpga import FpgaViState
from nifpga.nifpga import _NiFpga

import difffric as df
from difffric.acquisition import card
from difffric.acquisition.card import CardError, position_words, split_position
from difffric.acquisition.card_registers import AT_RESET, IRQ_PUSH_ENDED
from difffric.acquisition.push import Command
from difffric.acquisition.recorder import acquire
from difffric.acquisition.simulated_card import SimulatedCard
from difffric.measurements.files.tdms_reader import read_recordings
from fpga.emulator.emulator import (
    DESCRIPTION,
    RESOURCE,
    NoCompilerError,
    build,
    compiler,
    emulated_card,
)
from tests.compiler import needs_compiler

pytestmark = needs_compiler

status = vars(nifpga.status)  # the classes that nifpga makes when it is imported
RATE = 200_000
SLOW = Command(velocity=0.02, stroke=2e-3, mass=18.9)
FAST = Command(velocity=0.05, stroke=2e-3, mass=18.9)


@pytest.fixture
def emulated():
    """`emulated(...)`: a new card and an open session with it, running, FIFOs started."""
    with ExitStack() as stack:

        def make(*pushes, depth=100_000, **options):
            emulator = stack.enter_context(emulated_card(rate=RATE, **options))
            for push in pushes:
                emulator.add_push(*push)
            session = stack.enter_context(emulator.open())
            session.reset()
            for fifo in session.fifos.values():
                fifo.configure(depth)
                fifo.start()
            session.run()
            return emulator, session

        yield make


def test_no_compiler_is_one_clear_line(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(NoCompilerError, match="no C compiler: neither cc nor the ziglang wheel"):
        compiler()


def words_of(n, seed=0):
    random = np.random.default_rng(seed)
    return random.integers(-(2**15), 2**15, n), np.cumsum(random.integers(-3, 9, n)) - 50


def start(session):
    session.registers["start"].write(False)  # a push begins as it becomes true
    session.registers["start"].write(True)


def read(session, name):
    return session.registers[name].read()


def in_place(accessor):
    """The elements that a region's accessor holds, copied."""
    return np.ctypeslib.as_array(accessor._buffer, (len(accessor),)).copy()


def test_every_entry_point_that_nifpga_binds_is_there(emulated):
    emulated()
    bound = _NiFpga()._wrapped_functions
    missing = [x for x, call in bound.items() if "NiFpgaDll_" not in call.__wrapped__.__name__]
    assert len(bound) > 100 and not missing


def test_a_session_s_life():
    with emulated_card() as emulator:
        session = emulator.open()
        assert session.fpga_vi_state is FpgaViState.NotRunning
        session.run()
        assert session.fpga_vi_state is FpgaViState.Running
        with pytest.warns(status["FpgaAlreadyRunningWarning"]):
            session.run()
        session.registers["stroke_nm"].write(5)
        session.reset()
        assert session.fpga_vi_state is FpgaViState.NotRunning and read(session, "stroke_nm") == 0
        session.close()
        for call in (session.reset, session.close, session.registers["done"].read):
            with pytest.raises(status["InvalidSessionError"]):
                call()
        with nifpga.Session(str(DESCRIPTION), RESOURCE) as running:
            assert running.fpga_vi_state is FpgaViState.Running


def test_registers_of_each_type(emulated):
    _, session = emulated()
    assert {name: read(session, name) for name in AT_RESET} == AT_RESET | {"sample_rate_Hz": RATE}
    for name, values in (
        ("velocity_nm_per_s", (0, 1, 2**32 - 1)),
        ("contact_threshold_word", (-(2**15), -1, 2**15 - 1)),
    ):
        for value in values:
            session.registers[name].write(value)
            assert read(session, name) == value
    assert read(session, "done") is False  # Boolean, not 0
    for name in ("done", "peak_word", "release_count"):
        with pytest.raises(status["InvalidParameterError"]):
            session.registers[name].write(1)


def test_a_register_is_not_read_as_another_type(emulated):
    _, session = emulated()
    address = session.registers["peak_word"]._resource
    with pytest.raises(status["InvalidParameterError"]):
        _NiFpga()["ReadU32"](session._session, address, ctypes.c_uint32())
    number = session.fifos["force"]._number
    with pytest.raises(status["InvalidParameterError"]):
        buffer = (ctypes.c_int32 * 1)()
        _NiFpga()["ReadFifoI32"](session._session, number, buffer, 1, 0, ctypes.c_size_t())


def test_what_cannot_be_opened_says_why(tmp_path):
    other = tmp_path / "other.lvbitx"
    text = DESCRIPTION.read_text(encoding="utf-8")
    signature = nifpga.Bitfile(str(DESCRIPTION)).signature
    other.write_text(text.replace(signature, "0" * 32), encoding="utf-8")
    with emulated_card():
        with card.open_card(DESCRIPTION, RESOURCE) as session:
            card.check_interface(session)
        with pytest.raises(df.InputError, match=r"RIO0: no card can be opened.*SignatureMismatch"):
            card.open_card(other, RESOURCE)
        with pytest.raises(df.InputError, match=r"RIO7: no card can be opened.*ResourceNotFound"):
            card.open_card(DESCRIPTION, "RIO7")
    with emulated_card(signature="F" * 32), pytest.raises(df.InputError, match="Mismatch") as told:
        card.open_card(DESCRIPTION, RESOURCE)
    assert "\n" not in str(told.value)


def test_both_fifos_bring_the_words_in_order_however_they_are_read(emulated):
    words, counts = words_of(30_000)
    _, session = emulated((words, counts), depth=1000)
    random = np.random.default_rng(4)
    came = {"force": [], "position": []}
    start(session)
    while len(came["force"]) < len(words):
        n = min(int(random.integers(1, 400)), len(words) - len(came["force"]))
        for name, fifo in session.fifos.items():
            wanted, way = n, random.integers(4)
            while wanted:
                if way == 0:
                    part = fifo.read(wanted, timeout_ms=10).data
                elif way == 1:
                    region = fifo.acquire_read_region(wanted, timeout_ms=10).region
                    with region as accessor:
                        part = in_place(accessor).tolist()
                elif way == 2:
                    got = fifo._acquire_read(wanted, timeout_ms=10)
                    part = got.data[: got.elements_acquired]
                    fifo._release_elements(got.elements_acquired)
                else:  # the bound call, into an array of the caller's
                    array = np.empty(wanted, f"{'i2' if name == 'force' else 'u8'}")
                    pointer = array.ctypes.data_as(ctypes.POINTER(fifo._ctype_type))
                    rest = ctypes.c_size_t()
                    fifo._read_func(session._session, fifo._number, pointer, wanted, 10, rest)
                    part = array.tolist()
                came[name] += part
                wanted -= len(part)
    assert came["force"] == words.tolist()
    assert came["position"] == position_words(np.arange(len(words)), counts).tolist()
    assert not read(session, "overflow") and read(session, "streamed") == len(words)


def test_a_region_ends_where_the_ring_does(emulated):
    words, counts = words_of(2500)
    _, session = emulated((words, counts))
    force = session.fifos["force"]
    assert force.configure(1000) == 1000
    force.start()
    start(session)
    assert force.read(700, timeout_ms=10).data == words[:700].tolist()
    with pytest.raises(status["BadReadWriteCountError"]):
        force.acquire_read_region(1001, timeout_ms=10)
    first = force.acquire_read_region(500, timeout_ms=10)
    assert first.elements_acquired == 300  # asked for 500, and got what is left of the ring
    second = force.acquire_read_region(500, timeout_ms=10)
    assert second.elements_acquired == 500
    with pytest.raises(status["ElementsNotPermissibleToBeAcquiredError"]):
        force.acquire_read_region(400, timeout_ms=10)
    for call in (lambda: force.read(1), force.stop, lambda: force.configure(10)):
        with pytest.raises(status["FifoElementsCurrentlyAcquiredError"]):
            call()
    assert force.elements_currently_acquired == 800
    with second.region as accessor:
        assert in_place(accessor).tolist() == words[1000:1500].tolist()
    assert force.elements_currently_acquired == 800  # the card needs the older ones first
    with first.region as accessor:
        assert in_place(accessor).tolist() == words[700:1000].tolist()
    assert force.elements_currently_acquired == 0
    assert force.read(500, timeout_ms=10).data == words[1500:2000].tolist()


def test_a_region_that_is_not_released_shows_at_the_end():
    with emulated_card() as emulator:
        emulator.add_push(*words_of(100))
        session = emulator.open()
        session.run()
        session.fifos["position"].start()
        nothing = session.fifos["force"].acquire_read_region(0)
        assert nothing.elements_acquired == 0
        nothing.region.release()
        start(session)
        session.fifos["force"].acquire_read_region(10, timeout_ms=10)
        with pytest.raises(status["RegionsOutstandingForSessionError"]):
            session.close()


@pytest.mark.parametrize("real", [False, True])
def test_a_read_that_times_out_consumes_nothing(emulated, real):
    words, counts = words_of(2000)
    emulator, session = emulated((words, counts), real=real)
    force, position = session.fifos["force"], session.fifos["position"]
    start(session)
    began = emulator.now
    with pytest.raises(status["FifoTimeoutError"]) as timed_out:
        force.read(2001, timeout_ms=2)
    there = timed_out.value.get_args()["elements remaining"]
    assert emulator.now - began >= 2e-3 - 1e-9
    assert there == 400 if not real else 400 <= there <= 2000
    with pytest.raises(status["FifoTimeoutError"]):
        position.acquire_read_region(2001, timeout_ms=2)
    assert force.read(0).elements_remaining >= there
    got = force.read(2000, timeout_ms=1000)
    assert got.data == words.tolist() and got.elements_remaining == 0
    number, count = split_position(position.read(2000, timeout_ms=1000).data)
    assert number.tolist() == list(range(2000)) and count.tolist() == counts.tolist()


def test_a_wait_without_end_for_what_never_comes_ends_on_the_virtual_clock(emulated):
    _, session = emulated(words_of(100))
    start(session)
    with pytest.raises(status["FifoTimeoutError"]):
        session.fifos["force"].read(101, timeout_ms=0xFFFFFFFF)
    assert len(session.fifos["force"].read(100).data) == 100


def test_a_reset_stops_all_fifos_and_ends_the_push(emulated):
    words, counts = words_of(5000)
    _, session = emulated((words, counts), (words[::-1], counts))
    start(session)
    session.fifos["force"].read(100, timeout_ms=10)
    session.fifos["position"].acquire_read_region(100, timeout_ms=10)
    session.reset()
    assert session.fpga_vi_state is FpgaViState.NotRunning
    for fifo in session.fifos.values():
        assert fifo.read(0).elements_remaining == 0
    assert read(session, "samples") == 0 and session.wait_on_irqs([0], 100).timed_out
    start(session)  # nothing runs: nothing starts
    assert read(session, "samples") == 0
    session.run()
    start(session)
    assert session.fifos["force"].read(5000, timeout_ms=100).data == words[::-1].tolist()


def test_a_full_fifo_is_latched_and_counted_and_no_status(emulated):
    words, counts = words_of(3000)
    emulator, session = emulated((words, counts), (words, counts), depth=700)
    start(session)
    emulator.pass_time(1.0)  # a host that is busy elsewhere
    assert read(session, "overflow") and read(session, "done")
    assert (read(session, "samples"), read(session, "streamed")) == (3000, 700)
    assert session.fifos["force"].read(700).data == words[:700].tolist()
    assert len(session.fifos["position"].read(700).data) == 700
    with pytest.raises(status["FifoTimeoutError"]):
        session.fifos["force"].read(1, timeout_ms=100)  # closed until the push ends
    start(session)
    assert not read(session, "overflow")
    assert session.fifos["force"].read(700, timeout_ms=100).data == words[:700].tolist()


def test_a_fifo_that_is_not_started_overflows(emulated):
    _, session = emulated(words_of(100))
    session.fifos["position"].stop()
    start(session)
    assert session.wait_on_irqs([0], 10).irqs_asserted == [0]
    assert read(session, "overflow") and read(session, "streamed") == 0


def test_the_interrupt_comes_at_the_end_of_a_push(emulated):
    n = 4000
    emulator, session = emulated(words_of(n), words_of(n))
    start(session)
    began = emulator.now
    early = session.wait_on_irqs([0, 5], 1)
    assert early.timed_out and early.irqs_asserted == []
    ended = session.wait_on_irqs([IRQ_PUSH_ENDED], 1000)
    assert not ended.timed_out and ended.irqs_asserted == [0]
    assert emulator.now - began == pytest.approx(n / RATE, abs=1e-9)  # and no later
    assert read(session, "done") is True
    assert session.wait_on_irqs([0], 0).irqs_asserted == [0]  # stands until it is acknowledged
    session.acknowledge_irqs([1, 31])
    assert session.wait_on_irqs([0], 0).irqs_asserted == [0]
    session.acknowledge_irqs([0])
    assert session.wait_on_irqs([0], 5).timed_out
    start(session)
    assert session.wait_on_irqs([31], 1000).timed_out
    assert session.wait_on_irqs([0], 0).irqs_asserted == [0]


def latch(words, counts, low, high):
    """(released, sample, count) of contact made at `high` and lost below `low`."""
    contact, found = False, (False, 0, 0)
    for i, word in enumerate(words):
        if not contact and word >= high:
            contact, found = True, (False, *found[1:])
        elif contact and word < low:
            contact, found = False, (True, i, int(counts[i]))
    return found


@pytest.mark.parametrize("seed", range(6))
def test_what_the_card_makes_of_a_push(emulated, seed):
    """Emulator and simulated card against the definitions."""
    random = np.random.default_rng(seed)
    n, low, more = 3000, int(random.integers(-300, 300)), int(random.integers(0, 900))
    slow = 1500 * np.sin(np.arange(n) / random.uniform(10, 200))
    words = np.rint(slow + random.normal(0, 200, n)).astype(int)
    words = np.where(random.random(n) < 0.1, random.choice([low, low + more], n), words)  # ties
    words[random.integers(0, n, 9)] = random.choice([-(2**15), 2**15 - 1], 9)
    counts = np.cumsum(random.integers(-2, 9, n)) - 200
    controls = {"contact_threshold_word": low, "contact_hysteresis_word": more}

    parts = [(words[:end], counts[:end]) for end in (1, 70, 511, 700, 1024, n)]
    _, real_one = emulated(*parts)
    simulated = SimulatedCard(lambda velocity, stroke: (lambda t: (t, t), 1.0), rate=RATE)
    digitised = ((w, position_words(np.arange(len(w)), c)) for w, c in parts)
    simulated._digitise = lambda: next(digitised)
    for session in (real_one, simulated):
        for fifo in session.fifos.values():
            fifo.configure(n)
            fifo.start()
        for name, value in controls.items():
            session.registers[name].write(value)
        for force, count in parts:
            start(session)
            while not read(session, "done"):
                pass
            found = [read(session, x) for x in ("released", "release_sample", "release_count")]
            assert tuple(found) == latch(force, count, low, low + more)
            assert read(session, "peak_word") == force.max()
            ends = np.isin(force, (-(2**15), 2**15 - 1)).sum()
            assert read(session, "saturated_samples") == ends
            assert read(session, "encoder_error") is False
            assert read(session, "samples") == len(force)


def test_a_saturated_channel_and_a_dead_sensor_show(emulated):
    words = np.clip(np.linspace(-40_000, 40_000, 801), -(2**15), 2**15 - 1).astype(int)
    dead = np.zeros(500, int)
    _, session = emulated((words, np.arange(801)), (dead, np.arange(500)))
    start(session)
    session.wait_on_irqs([0], 1000)
    assert read(session, "peak_word") == 2**15 - 1
    assert read(session, "saturated_samples") == (np.abs(words + 0.5) > 2**15 - 1).sum() > 100
    session.acknowledge_irqs([0])
    start(session)
    session.wait_on_irqs([0], 1000)
    assert read(session, "peak_word") == 0 and read(session, "saturated_samples") == 0
    assert not read(session, "released")


def test_a_card_that_falls_silent(emulated):
    words, counts = words_of(3000)
    emulator, session = emulated()
    emulator.add_push(words, counts, silent_at=1234)
    start(session)
    with pytest.raises(status["FifoTimeoutError"]):
        session.fifos["force"].read(1235, timeout_ms=1000)
    assert session.fifos["force"].read(1234).data == words[:1234].tolist()
    assert read(session, "samples") == 1234 and not read(session, "done")
    assert session.wait_on_irqs([0], 1000).timed_out


@pytest.mark.parametrize("real", [False, True])
def test_a_card_removed_mid_push_fails_every_call(real):
    with emulated_card(rate=RATE, real=real) as emulator:
        emulator.add_push(*words_of(100_000), removed_at=60_000)
        session = emulator.open()
        session.run()
        force = session.fifos["force"]
        for fifo in session.fifos.values():
            fifo.configure(100_000)
            fifo.start()
        start(session)
        assert len(force.read(900, timeout_ms=1000).data) == 900
        for call in (
            lambda: force.read(90_000, timeout_ms=1000),
            lambda: session.registers["done"].read(),
            lambda: session.wait_on_irqs([0], 100),
            session.reset,
            force.stop,
            session.close,
        ):
            with pytest.raises(status["HardwareFaultError"]):
                call()
        with pytest.raises(status["HardwareFaultError"]):
            emulator.open()


def test_the_encoder_s_error_is_latched_until_the_next_push(emulated):
    emulator, session = emulated()
    emulator.add_push(*words_of(3000), encoder_error_at=2000)
    emulator.add_push(*words_of(3000))
    start(session)
    session.fifos["force"].read(1000, timeout_ms=100)
    assert not read(session, "encoder_error")
    session.wait_on_irqs([0], 100)
    assert read(session, "encoder_error")
    start(session)
    assert not read(session, "encoder_error")


def test_any_call_can_be_made_to_fail(emulated):
    emulator, session = emulated(words_of(100))
    emulator.fail("ReadU32", status["CommunicationTimeoutError"].CODE, skip=2, times=1)
    samples = [read(session, "samples") for _ in range(2)]
    with pytest.raises(status["CommunicationTimeoutError"]):
        read(session, "samples")
    assert [*samples, read(session, "samples")] == [0, 0, 0]
    emulator.fail("StartFifo", 61083)  # a warning comes with what the call does
    session.fifos["force"].stop()
    with pytest.warns(status["ClockLostLockWarning"]):
        session.fifos["force"].start()
    start(session)
    assert len(session.fifos["force"].read(100, timeout_ms=10).data) == 100
    emulator.fail("Open", status["DownloadErrorError"].CODE)
    with pytest.raises(status["DownloadErrorError"]):
        emulator.open()


def test_fifo_properties(emulated):
    _, session = emulated()
    force = session.fifos["force"]
    with pytest.raises(status["OperationNotSupportedWhileStartedError"]):
        force.buffer_size = 10
    force.stop()
    force.buffer_allocation_granularity = 2048
    assert force.configure(5000) == force.buffer_size == 6144
    with pytest.raises(status["BadDepthError"]):
        force.configure(0)
    with pytest.raises(status["FeatureNotSupportedError"]):
        force.write([1, 2])


def test_a_push_can_be_played_over_and_over(emulated):
    words, counts = words_of(1777)
    emulator, session = emulated()
    emulator.add_push(words, counts, repeats=1000)
    start(session)
    for at in range(0, 1_777_000, 88_850):
        got = session.fifos["force"].acquire_read_region(88_850, timeout_ms=1000)
        number, count = np.zeros(0, int), np.zeros(0, int)
        with got.region as accessor:
            index = np.arange(at, at + got.elements_acquired)
            assert np.array_equal(in_place(accessor), words[index % 1777])
        session.fifos["force"].read(88_850 - got.elements_acquired, timeout_ms=1000)
        while len(number) < 88_850:
            region = session.fifos["position"].acquire_read_region(88_850 - len(number), 1000)
            with region.region as accessor:
                parts = split_position(in_place(accessor))
            number, count = (np.append(*x) for x in zip((number, count), parts, strict=True))
        assert np.array_equal(number, np.arange(at, at + 88_850))
        assert np.array_equal(count, counts[number % 1777])
    assert read(session, "samples") == read(session, "streamed") == 1_777_000


def test_the_real_clock_brings_samples_as_time_goes_on(emulated):
    n = 20_000
    words, counts = words_of(n)
    _, session = emulated((words, counts), real=True)
    began = time.monotonic()
    start(session)
    assert session.fifos["force"].read(n // 2, timeout_ms=5000).data == words[: n // 2].tolist()
    assert time.monotonic() - began >= n / 2 / RATE
    assert session.wait_on_irqs([0], 5000).irqs_asserted == [0]
    assert time.monotonic() - began >= n / RATE
    assert read(session, "streamed") == n


def test_another_thread_may_start_what_one_waits_for(emulated):
    _, session = emulated(words_of(100), real=True)
    timer = threading.Timer(0.05, lambda: start(session))
    timer.start()
    assert session.wait_on_irqs([0], 10_000).irqs_asserted == [0]
    timer.join()


def bump(velocity, stroke):
    """A push in two lines, without physics."""
    end = stroke / velocity

    def evaluate(t):
        s = np.clip(t / end, 0.0, 1.0)
        return np.where((t >= 0) & (t < end), 400 * np.sin(np.pi * s), 0.0), stroke * s**2

    return evaluate, end


def played(path, pushes, **options):
    """A recording through the simulated card, and the words that it played."""
    simulated, words = SimulatedCard(bump, rate=10_000, seed=3), []
    digitised = simulated._digitise

    def spy():
        force, position = digitised()
        words.append((force, split_position(position)[1]))
        return force, position

    simulated._digitise = spy
    return acquire(simulated, pushes, path, **options), words


@pytest.mark.parametrize("real", [False, True])
def test_a_recording_is_the_same_through_nifpga_as_through_the_simulated_card(tmp_path, real):
    pushes = [FAST, FAST] if real else [SLOW, FAST, SLOW]
    expected, words = played(tmp_path / "simulated.tdms", pushes)
    with emulated_card(rate=10_000, real=real) as emulator:
        for push in words:
            emulator.add_push(*push)
        with card.open_card(DESCRIPTION, RESOURCE) as session:
            acquired = acquire(session, pushes, tmp_path / "emulated.tdms")
    assert acquired == expected and not any(push.lost for push in acquired)
    simulated, emulated = (tmp_path / f"{x}.tdms" for x in ("simulated", "emulated"))
    assert simulated.read_bytes() == emulated.read_bytes()


def busy_after_start(emulator, session, seconds):
    """The host is elsewhere for a while as soon as it has started a push."""
    register = session.registers["start"]
    write = register.write

    def write_and_leave(data):
        write(data)
        if data:
            emulator.pass_time(seconds)

    register.write = write_and_leave


def test_samples_lost_by_the_emulated_card_are_counted(tmp_path):
    path = tmp_path / "cut.tdms"
    whole, words = played(tmp_path / "whole.tdms", [FAST, FAST])
    with emulated_card(rate=10_000) as emulator:
        for push in words:
            emulator.add_push(*push)
        with emulator.open() as session:
            busy_after_start(emulator, session, 0.05)
            acquired = acquire(session, [FAST, FAST], path, depth=300)
    cut = read_recordings(path)
    for all_of_it, one, kept in zip(whole, acquired, cut, strict=True):
        assert one.lost > 0 and one.samples + one.lost == all_of_it.samples
        assert kept.force.n == one.samples


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"removed_at": 400}, "HardwareFault"),
        ({"silent_at": 400}, "400 samples came of 400 sent, then none"),
    ],
)
def test_a_card_that_fails_mid_push_is_one_line_and_leaves_whole_pushes(tmp_path, fault, words):
    path = tmp_path / "pushes.tdms"
    whole, pushes = played(tmp_path / "whole.tdms", [FAST, FAST])
    with emulated_card(rate=10_000) as emulator:
        emulator.add_push(*pushes[0])
        emulator.add_push(*pushes[1], **fault)
        session = emulator.open()
        with pytest.raises(CardError, match=words) as failed:
            acquire(session, [FAST, FAST], path, timeout=0.05)
    assert "push_0002" in str(failed.value) and "\n" not in str(failed.value)
    assert read_recordings(path)[0].force.n == whole[0].samples


def test_the_library_is_found_where_the_system_looks(tmp_path):
    """By its soname, in a process in which nothing is patched."""
    library = build()
    code = """
import ctypes, sys
if ctypes.util.find_library("NiFpga") is None:
    sys.exit(77)
from difffric.acquisition.card import open_card
with open_card(sys.argv[1]) as session:
    print(session.registers["sample_rate_Hz"].read(), len(session.fifos))
"""
    done = subprocess.run(
        [sys.executable, "-c", "import ctypes.util" + code, str(DESCRIPTION)],
        env={**os.environ, "LD_LIBRARY_PATH": str(library.parent)},
        cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    if done.returncode == 77:
        pytest.skip("ctypes finds no library here by LD_LIBRARY_PATH: it needs ld or gcc")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["200000", "2"]


def test_a_push_begins_only_as_start_becomes_true():
    words, counts = words_of(50)
    with emulated_card(rate=RATE, look=1e-6) as emulator:
        for _ in range(2):
            emulator.add_push(words, counts)
        with emulator.open() as session:
            session.run()
            start(session)
            emulator.pass_time(1.0)
            assert read(session, "samples") == 50
            session.registers["start"].write(True)  # as it stands
            assert read(session, "samples") == 50 and read(session, "done")
            start(session)
            emulator.pass_time(10 / RATE)
            assert read(session, "samples") < 50
