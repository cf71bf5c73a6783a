"""What goes wrong while pushes are recorded is one clear line, and takes no sample that came: the
real nifpga against the emulated card."""

from __future__ import annotations

import errno
import json
import os
from contextlib import contextmanager

import nifpga
import numpy as np
import pytest
from nptdms import TdmsFile

from difffric.acquisition.card import CardError
from difffric.acquisition.push import Command
from difffric.acquisition.recorder import acquire
from difffric.acquisition.stream import SEGMENT
from difffric.commands.reports.acquire import Run, describe_run, report_run, require_all_samples
from difffric.errors import DiskError
from difffric.measurements.files import tdms_writer
from difffric.measurements.files.tdms_reader import read_recordings
from difffric.rig.setup_toml import read_setup
from fpga.emulator.emulator import emulated_card
from studies.acquisition_kills import kills
from studies.acquisition_rate import answered
from tests.compiler import needs_compiler

pytestmark = needs_compiler

status = vars(nifpga.status)
PUSH = Command(velocity=0.05, stroke=2e-3, mass=18.9)
N = 30_000


def words_of(n=N, seed=0):
    """Contact made and lost, with noise, and the encoder's counts."""
    random, s = np.random.default_rng(seed), np.linspace(0, 1, n)
    force = 6000 * np.sin(np.pi * np.clip(3 * s - 1, 0, 1)) + random.normal(0, 20, n)
    return np.rint(force).astype(int), np.rint(1e5 * np.clip(s, 0.3, 0.7)).astype(int)


@contextmanager
def card(*pushes, **options):
    """The emulated card with pushes to play, each (words, counts, faults), and a session."""
    with emulated_card(**options) as emulator:
        for words, counts, *faults in pushes:
            emulator.add_push(words, counts, **(faults[0] if faults else {}))
        yield emulator, emulator.open()


def leave(emulator, session, seconds, when=lambda: True):
    """Let the host be elsewhere for a while as soon as it has started a push."""
    register = session.registers["start"]
    write = register.write

    def write_and_leave(data):
        write(data)
        if data and when():
            emulator.pass_time(seconds)

    register.write = write_and_leave


def same(path, *pushes):
    """Whether the groups of a file hold these words, each up to where it ends."""
    groups = TdmsFile.read(path).groups()
    assert len(groups) == len(pushes)
    for group, (words, counts) in zip(groups, pushes, strict=True):
        n = len(group["force"])
        assert n == len(group["position"]) == group["force"].properties["wf_samples"]
        assert np.array_equal(group["force"].raw_data, words[:n])
        assert np.array_equal(group["position"].raw_data, counts[:n])
    return True


def test_the_card_s_own_peak_and_latch_agree_with_what_is_recorded(tmp_path):
    words, counts = words_of()
    with card((words, counts)) as (_, session):
        (push,) = acquire(session, [PUSH], tmp_path / "pushes.tdms")
    seen = push.hardware
    assert seen.agrees is True and not push.troubles
    assert seen.peak_word == words.max() and seen.released
    assert words[seen.release_sample] < 74 and seen.release_count == counts[seen.release_sample]


@pytest.mark.parametrize(
    ("register", "off", "told"),
    [
        ("peak_word", 1, "peak word"),
        ("release_sample", -1, "latched"),
        ("release_count", 3, "latched"),
        ("saturated_samples", -1, "saturated"),
    ],
)
def test_a_card_that_says_otherwise_than_its_words_is_told_of(tmp_path, register, off, told):
    with card(words_of()) as (_, session):
        one = session.registers[register]
        read, lines = one.read, []
        one.read = lambda: read() + off
        (push,) = acquire(
            session, [PUSH], tmp_path / "pushes.tdms", tell=lambda *x: lines.append(x[0])
        )
    assert push.hardware.agrees is False
    assert any(told in line and "push_0001" in line for line in lines)


def test_a_full_fifo_is_told_and_its_samples_counted(tmp_path):
    words, counts = words_of()
    path, lines, busy = tmp_path / "pushes.tdms", [], iter([False, True, False])
    with card(*3 * [(words, counts)]) as (emulator, session):
        leave(emulator, session, 0.1, lambda: next(busy))
        pushes = acquire(session, 3 * [PUSH], path, depth=5000, tell=lambda *x: lines.append(x[0]))
    assert [push.lost for push in pushes] == [0, N - 5000, 0]
    assert [push.hardware.overflow for push in pushes] == [False, True, False]
    assert [push.hardware.agrees for push in pushes] == [True, None, True]
    assert f"push_0002: {N - 5000} samples lost" in lines
    assert same(path, *3 * [(words, counts)])
    assert TdmsFile.read(path)["push_0002"].properties["lost_samples"] == N - 5000
    run = Run(pushes, 3 * [None], [], path.name, 2e-8, None)
    with pytest.raises(CardError, match=r"25000 samples were lost \(a FIFO was full\), in push_0"):
        require_all_samples(run)
    answer = describe_run(run)
    assert answer["lost_samples"] == N - 5000 and answer["pushes"][1]["hardware"]["overflow"]
    assert any("lost" in line for line in report_run(answer, run).summary)


def test_a_card_that_falls_silent_is_a_time_out(tmp_path):
    words, counts = words_of()
    path = tmp_path / "pushes.tdms"
    with (
        card((words, counts), (words, counts, {"silent_at": 12_345})) as (_, session),
        pytest.raises(CardError, match="12345 samples came of 12345 sent, then none") as failed,
    ):
        acquire(session, 3 * [PUSH], path, timeout=0.1)
    assert "push_0002" in str(failed.value) and "\n" not in str(failed.value)
    assert same(path, (words, counts), (words, counts))
    recorded = read_recordings(path)
    assert [push.force.n for push in recorded] == [N, 12_345]
    complete = [group.properties["complete"] for group in TdmsFile.read(path).groups()]
    assert complete == [True, False]


@pytest.mark.parametrize("real", [False, True])
def test_a_card_that_is_removed_leaves_what_came(tmp_path, real):
    words, counts = words_of()
    path = tmp_path / "pushes.tdms"
    gone = {"removed_at": 20_000}
    with (
        card((words, counts), (words, counts, gone), real=real) as (_, session),
        pytest.raises(CardError, match=r"push_0002: the card failed: .*HardwareFault") as one,
    ):
        acquire(session, 2 * [PUSH], path)
    assert "\n" not in str(one.value) and f"whole pushes in {path}: 1" in str(one.value)
    assert same(path, (words, counts), (words, counts))
    # Words of the last block were with the driver only.
    kept = read_recordings(path)[1].force.n
    assert 18_000 < kept <= 20_000 and f"the file has {kept} samples" in str(one.value)


def test_a_call_that_times_out_at_the_bus_is_one_line(tmp_path):
    with card(words_of()) as (emulator, session):
        code = status["CommunicationTimeoutError"].CODE
        emulator.fail("ReadFifoU64", code, skip=7)
        with pytest.raises(CardError, match=r"push_0001: the card failed: .*CommunicationTimeout"):
            acquire(session, [PUSH], tmp_path / "pushes.tdms")
    assert same(tmp_path / "pushes.tdms", words_of())


def test_pushes_that_are_not_to_be_trusted_are_recorded_and_marked(tmp_path):
    words, counts = words_of()
    clipped = np.clip(8 * words, -(2**15), 2**15 - 1)
    dead = np.full(N, 7)
    path, lines = tmp_path / "pushes.tdms", []
    given = [(clipped, counts), (words, counts), (dead, counts), (words, counts)]
    with card(*given[:1], (words, counts, {"encoder_error_at": 9000}), *given[2:]) as (_, session):
        pushes = acquire(session, 4 * [PUSH], path, tell=lambda *x: lines.append(x[0]))
    n = int((clipped == 2**15 - 1).sum())
    assert [push.fault for push in pushes] == [
        f"saturated: {n} samples at an end of the converter",
        "encoder error: the counts are off from there on",
        f"dead sensor: each of {N} force words is 7",
        "",
    ]
    assert all(push.hardware.agrees for push in pushes)
    assert sum(push.fault in line for push in pushes[:3] for line in lines) == 3
    assert same(path, *given)


class FullDisk:
    """A file on a disk that has room for so many bytes."""

    def __init__(self, file, room):
        self._file, self.room = file, room

    def __getattr__(self, name):
        return getattr(self._file, name)

    def write(self, data):
        if self.room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        n = min(len(data), self.room)
        self.room -= n
        return self._file.write(data[:n])


@pytest.mark.parametrize("room", [100, 4000, 700_000, 1_220_000])
def test_a_full_disk_ends_the_recording_and_keeps_what_is_on_it(tmp_path, monkeypatch, room):
    words, counts = words_of(2 * SEGMENT + 5000)
    path = tmp_path / "pushes.tdms"
    growing = tdms_writer._Growing

    def small(path, replace):
        file = growing(path, replace)
        file._file = FullDisk(file._file, room if not replace else 1 << 30)
        return file

    monkeypatch.setattr(tdms_writer, "_Growing", small)
    with (
        card((words, counts)) as (_, session),
        pytest.raises(DiskError, match=r"push_0001: .*No space left on device") as failed,
    ):
        acquire(session, [PUSH], path)
    whole = max(room // (6 * SEGMENT), 0) * SEGMENT
    assert f"the file has {whole} samples of it, of " in str(failed.value)
    assert "\n" not in str(failed.value)
    if whole:
        assert same(path, (words, counts)) and read_recordings(path)[0].force.n == whole


def test_the_index_says_what_the_file_holds(tmp_path):
    words, counts = words_of(250_000)
    path = tmp_path / "pushes.tdms"
    with card((words, counts), (words[:500], counts[:500])) as (_, session):
        acquire(session, 2 * [PUSH], path)
    index = tmp_path / "pushes.tdms_index"
    assert index.exists() and index.read_bytes()[:4] == b"TDSh"
    with_index = TdmsFile.read(path)
    index.rename(tmp_path / "elsewhere")
    without = TdmsFile.read(path)
    for one, other in zip(with_index.groups(), without.groups(), strict=True):
        assert one.properties == other.properties
        for channel in ("force", "position"):
            assert one[channel].properties == other[channel].properties
            assert np.array_equal(one[channel].raw_data, other[channel].raw_data)


def test_pushes_are_identified_through_nifpga_as_they_come(tmp_path):
    """As the card would send them: the simulated rig's words, on the real clock."""
    setup = read_setup("examples/setup.toml")
    pushes = [Command(v, 1.2e-3, 18.9) for v in (0.05, 0.08, 0.05)]
    run = answered(setup, pushes, 50_000, tmp_path)
    answer = json.loads(json.dumps(describe_run(run)))
    for push in answer["pushes"]:
        assert push["hardware"]["agrees"] and push["reason"] is None
        for way in ("mu_s_force", "mu_s_distance", "mu_s_weighted", "mu_s_optimal"):
            found = push[way]
            assert abs(found["value"] - 0.12) < 5 * found["standard_error"]
        assert push["peak_force_N"]["value"] < push["hardware"]["peak_force_N"]
        assert push["answered_after_s"] > 0  # how soon: studies/acquisition_rate.py measures it


def test_a_kill_at_any_moment_leaves_a_file_with_all_that_was_flushed(tmp_path):
    kills(tmp_path, 5, seed=0)


@pytest.mark.slow
def test_50_kills(tmp_path):
    kills(tmp_path, 50, seed=1)
