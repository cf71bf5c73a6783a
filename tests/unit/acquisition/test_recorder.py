"""What the card takes is what the file holds, and what it lost is counted."""

from __future__ import annotations

import ctypes.util
import inspect
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import nifpga
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nifpga.session import _FIFO, _Register
from nifpga.status import FifoTimeoutError, HardwareFaultError
from nptdms import TdmsFile

import difffric as df
from difffric.acquisition import card, simulated_card
from difffric.acquisition.card import METRES_PER_COUNT, VOLTS_PER_WORD, CardError
from difffric.acquisition.push import Command
from difffric.acquisition.recorder import acquire
from difffric.acquisition.simulated_card import SimulatedCard
from difffric.measurements.files.tdms_reader import read_recordings
from difffric.units import from_mm_min

SENSITIVITY = 11.2e-3
SLOW = Command(velocity=0.02, stroke=2e-3, mass=18.9, condition="DRY")
FAST = Command(velocity=0.05, stroke=2e-3, mass=18.9)
SETUP = """
[part]
mass_kg = 18.9
[friction]
mu_s = 0.141
mu_s_scatter = 0.02
k_v_N_s_per_m = 5.0
[contact]
k_N_per_m = 8.0e5
b_N_s_per_m = 1500.0
[force_sensor]
rate_Hz = 10000.0
"""


def bump(velocity, stroke):
    """A push in two lines: a half-wave of force from a jump at t = 0, and a smooth step."""
    end = stroke / velocity

    def evaluate(t):
        s = np.clip(t / end, 0.0, 1.0)
        force = np.where((t >= 0) & (t < end), 2000 * velocity + 100 * np.sin(np.pi * s), 0.0)
        return force, stroke * s**2 * (3 - 2 * s)

    return evaluate, end


def quiet_card(**options):
    return SimulatedCard(bump, noise_force=0.0, noise_position=0.0, **options)


def samples(path, name, channel):
    """(times [s], samples in the file's unit), by npTDMS alone."""
    one = TdmsFile.read(path)[name][channel]
    says = one.properties
    return says["wf_start_offset"] + says["wf_increment"] * np.arange(len(one)), one[:]


def test_without_noise_samples_are_the_trace_to_half_a_step(tmp_path):
    path = tmp_path / "pushes.tdms"
    acquire(quiet_card(rate=10_000), [SLOW, FAST], path)
    for name, command in (("push_0001", SLOW), ("push_0002", FAST)):
        evaluate, end = bump(command.velocity, command.stroke)
        t, volts = samples(path, name, "force")
        force, position = evaluate(t)
        assert t[0] == pytest.approx(-0.02 + 0.5e-4, abs=1e-12) and t[-1] >= end + 0.03 - 1e-4
        assert np.abs(volts - SENSITIVITY * force).max() <= VOLTS_PER_WORD / 2 * (1 + 1e-9)
        t, x = samples(path, name, "position")
        assert np.abs(x - position).max() <= METRES_PER_COUNT / 2 * (1 + 1e-6)


def test_the_file_says_what_was_commanded(tmp_path):
    path = tmp_path / "pushes.tdms"
    acquired = acquire(quiet_card(rate=10_000), [SLOW, FAST], path)
    group = TdmsFile.read(path)["push_0001"]
    assert group.properties == {
        "velocity_mm_min": 1200.0, "stroke_mm": 2.0, "mass_kg": 18.9, "condition": "DRY",
        "order": 1, "complete": True, "lost_samples": 0,
    }  # fmt: skip
    assert group["force"].properties["unit_string"] == "V"
    assert group["force"].properties["wf_increment"] == 1e-4
    assert group["force"].properties["wf_samples"] == acquired[0].samples == len(group["force"])
    pushes = read_recordings(path)
    assert [push.name for push in pushes] == ["push_0001", "push_0002"]
    assert [push.velocity for push in pushes] == pytest.approx([0.02, 0.05], rel=1e-15)
    assert pushes[1].stroke == 2e-3 and pushes[1].mass == 18.9 and pushes[1].condition == ""


def test_the_recording_handed_over_is_the_one_in_the_file(tmp_path):
    path, handed = tmp_path / "pushes.tdms", []
    acquire(quiet_card(rate=10_000), [SLOW, FAST], path, on_push=lambda *both: handed.append(both))
    for (acquired, mine), theirs in zip(handed, read_recordings(path), strict=True):
        assert acquired.name == mine.name == theirs.name and acquired.lost == 0
        assert np.array_equal(mine.force.samples, theirs.force.samples)
        assert np.allclose(mine.position.samples, theirs.position.samples, rtol=0, atol=1e-18)
        assert (mine.force.dt, mine.force.start) == (theirs.force.dt, theirs.force.start)


def test_noise_is_white_with_the_stated_deviation(tmp_path):
    path = tmp_path / "pushes.tdms"
    acquire(SimulatedCard(bump, seed=3), [SLOW], path)
    evaluate, _ = bump(SLOW.velocity, SLOW.stroke)
    t, volts = samples(path, "push_0001", "force")
    force, position = evaluate(t)
    _, x = samples(path, "push_0001", "position")
    n = len(t)
    assert n == 30_000
    # Each bound is 4.5 standard deviations of its statistic over n white samples.
    for residual, noise, step in (
        (volts / SENSITIVITY - force, 0.5, VOLTS_PER_WORD / SENSITIVITY),
        (x - position, 0.3e-6, METRES_PER_COUNT),
    ):
        sigma = np.hypot(noise, step / np.sqrt(12))
        assert abs(residual.mean()) < 4.5 * sigma / np.sqrt(n)
        assert abs(residual.std() / sigma - 1) < 4.5 / np.sqrt(2 * n)
        assert abs(np.corrcoef(residual[:-1], residual[1:])[0, 1]) < 4.5 / np.sqrt(n)


def test_the_same_seed_gives_the_same_file_whatever_the_host_s_pace(tmp_path):
    files = [tmp_path / f"{i}.tdms" for i in range(3)]
    for path, seed, look in zip(files, (1, 1, 2), (1e-3, 7.3e-3, 1e-3), strict=True):
        acquire(SimulatedCard(bump, rate=10_000, seed=seed, look=look), [SLOW, FAST], path)
    first, same, other = (path.read_bytes() for path in files)
    assert first == same and first != other


def test_force_is_clipped_at_the_sensor_s_range(tmp_path):
    path = tmp_path / "pushes.tdms"
    acquire(quiet_card(rate=10_000, range=150.0), [FAST], path)
    _, volts = samples(path, "push_0001", "force")
    assert volts.max() == pytest.approx(150.0 * SENSITIVITY, abs=VOLTS_PER_WORD / 2)


def test_a_read_that_times_out_consumes_nothing():
    session = quiet_card(rate=10_000)
    for fifo in session.fifos.values():
        fifo.configure(1000)
        fifo.start()
    session.registers["velocity_nm_per_s"].write(20_000_000)
    session.registers["stroke_nm"].write(2_000_000)
    session.registers["start"].write(True)
    force = session.fifos["force"]
    with pytest.raises(FifoTimeoutError):
        force.read(500, timeout_ms=10)  # 100 samples come in this time
    assert force.read(0).elements_remaining >= 100
    got = force.read(500, timeout_ms=100)
    assert len(got.data) == 500
    evaluate, _ = bump(0.02, 2e-3)
    volts = SENSITIVITY * evaluate((np.arange(500) + 0.5) * 1e-4)[0]
    assert np.abs(np.array(got.data) * VOLTS_PER_WORD - volts).max() <= VOLTS_PER_WORD / 2 * 1.001


def test_lost_samples_are_counted_and_the_recording_ends_before_them(tmp_path):
    whole, cut = tmp_path / "whole.tdms", tmp_path / "cut.tdms"
    everything = acquire(quiet_card(), [FAST, FAST], whole)
    slow_host, told = quiet_card(look=5e-3), []
    acquired = acquire(
        slow_host, [FAST, FAST], cut, depth=700, tell=lambda *what: told.append(what)
    )
    assert slow_host.registers["overflow"].read() is True
    assert slow_host.registers["streamed"].read() == acquired[-1].samples
    for all_of_it, one in zip(everything, acquired, strict=True):
        assert all_of_it.lost == 0 and one.lost > 0
        assert one.samples + one.lost == all_of_it.samples
        for channel in ("force", "position"):
            kept = samples(cut, one.name, channel)[1]
            assert np.array_equal(kept, samples(whole, one.name, channel)[1][: one.samples])
    assert [words for words, _ in told if "lost" in words] == [
        f"{one.name}: {one.lost} samples lost" for one in acquired
    ]


class Wrapped:
    """A FIFO with a fault put between it and the host."""

    def __init__(self, fifo, fault):
        self._fifo, self._fault, self.came = fifo, fault, 0

    def __getattr__(self, name):
        return getattr(self._fifo, name)

    def read_into(self, buffer, timeout_ms=0):
        remaining = self._fifo.read_into(buffer, timeout_ms)
        self.came += len(buffer)
        return self._fault(buffer, self.came, remaining)


class Faulty:
    """A simulated card with a fault between one of its FIFOs and the host."""

    def __init__(self, which, fault):
        self._card = quiet_card(rate=10_000)
        self.registers = self._card.registers
        self.fifos = {**self._card.fifos, which: Wrapped(self._card.fifos[which], fault)}

    def __getattr__(self, name):
        return getattr(self._card, name)


def test_a_gap_in_the_sample_numbers_ends_the_recording_there(tmp_path):
    def skip(words, came, remaining):
        late = came - len(words) + np.arange(len(words)) >= 321
        words += late.astype(np.uint64) << np.uint64(32)
        return remaining

    path = tmp_path / "pushes.tdms"
    (one,) = acquire(Faulty("position", skip), [FAST], path)
    (whole,) = acquire(quiet_card(rate=10_000), [FAST], tmp_path / "whole.tdms")
    assert one.samples == 321 == len(samples(path, "push_0001", "force")[0])
    assert one.lost == whole.samples - 321


def test_a_card_that_fails_says_so_in_one_line_and_leaves_what_came(tmp_path):
    def fail(words, came, remaining):
        if came > 3000:
            raise HardwareFaultError("NiFpgaDll_ReadFifoI16", ["session", "fifo"], (1, 2))
        return remaining

    path = tmp_path / "pushes.tdms"
    (whole, *_) = acquire(quiet_card(rate=10_000), [FAST], tmp_path / "whole.tdms")
    with pytest.raises(CardError) as failed:
        acquire(Faulty("force", fail), [FAST] * 5, path)
    message = str(failed.value)
    assert "HardwareFault" in message and f"whole pushes in {path}: 3" in message
    assert "\n" not in message
    pushes = read_recordings(path)
    assert [push.force.n for push in pushes[:3]] == [whole.samples] * 3
    assert len(pushes) == 4 and sum(push.force.n for push in pushes) <= 3000


def test_a_card_that_falls_silent_is_not_waited_for(tmp_path):
    def dead(words, came, remaining):
        if came > 400:
            raise FifoTimeoutError("NiFpgaDll_ReadFifoI16", ["session", "fifo"], (1, 2))
        return remaining

    path = tmp_path / "pushes.tdms"
    with pytest.raises(CardError, match=r"push_0001: \d+ samples came of \d+ sent, then none"):
        acquire(Faulty("force", dead), [FAST], path, timeout=0.05)
    assert read_recordings(path)[0].force.n == 400


def test_what_was_recorded_survives_a_kill_between_pushes(tmp_path):
    path = tmp_path / "pushes.tdms"
    code = f"""
import os, signal
from tests.unit.acquisition.test_recorder import FAST, SLOW, acquire, quiet_card
def kill(acquired, recording):
    if acquired.name == "push_0002":
        os.kill(os.getpid(), signal.SIGKILL)
acquire(quiet_card(rate=10_000), [SLOW, FAST, SLOW], {str(path)!r}, on_push=kill)
"""
    root = Path(__file__).parents[3]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, timeout=120)
    assert done.returncode == -signal.SIGKILL
    expected = acquire(quiet_card(rate=10_000), [SLOW, FAST], tmp_path / "whole.tdms")
    killed = read_recordings(path)
    assert [p.force.n for p in killed] == [p.position.n for p in killed]
    assert [p.force.n for p in killed] == [one.samples for one in expected]


def test_a_card_that_fails_at_once_leaves_no_file(tmp_path):
    def fail(words, came, remaining):
        raise HardwareFaultError("NiFpgaDll_ReadFifoI16", ["session", "fifo"], (1, 2))

    path = tmp_path / "pushes.tdms"
    with pytest.raises(CardError, match="push_0001: the card failed: Error: HardwareFault"):
        acquire(Faulty("force", fail), [FAST], path)
    assert not path.exists()


def test_a_recording_is_never_overwritten(tmp_path):
    path = tmp_path / "pushes.tdms"
    path.write_bytes(b"mine")
    with pytest.raises(df.InputError, match=r"pushes\.tdms: exists"):
        acquire(quiet_card(), [FAST], path)
    assert path.read_bytes() == b"mine"


def test_a_bitfile_of_something_else_is_named(tmp_path):
    session = quiet_card()
    del session.registers["overflow"], session.registers["done"], session.fifos["position"]
    with pytest.raises(df.InputError, match="lacks registers done, overflow and FIFOs position"):
        acquire(session, [FAST], tmp_path / "pushes.tdms")
    assert not (tmp_path / "pushes.tdms").exists()


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf, 5.0, 1e-10])
def test_a_command_outside_the_registers_is_refused(bad):
    with pytest.raises(df.InputError, match="velocity: expected"):
        Command(bad, 2e-3)
    with pytest.raises(df.InputError, match="stroke: expected"):
        Command(0.05, bad)


@given(st.integers(0, 2**32 - 1), st.integers(-(2**31), 2**31 - 1))
def test_position_words_hold_number_and_count(index, count):
    assert [int(x[0]) for x in card.split_position(card.position_words([index], [count]))] == [
        index, count,
    ]  # fmt: skip


def test_nifpga_and_the_simulated_card_take_the_calls_that_are_made():
    """Every call that a protocol allows can be bound to the real class's signature."""
    calls = []
    for protocol, *classes in (
        (card.CardSession, nifpga.Session, SimulatedCard),
        (card.Fifo, _FIFO, simulated_card._SimulatedFifo),
        (card.Register, _Register, simulated_card._SimulatedRegister),
    ):
        names = [n for n, m in vars(protocol).items() if inspect.isfunction(m)]
        for name in set(names) - {"__init__", "__subclasshook__"}:
            wanted = list(inspect.signature(vars(protocol)[name]).parameters.values())
            fixed = [p for p in wanted if p.kind is p.POSITIONAL_ONLY or p.name == "self"]
            named = {p.name: None for p in wanted if p not in fixed}
            for one in classes:
                inspect.signature(getattr(one, name)).bind(*fixed, **named)
            calls.append(name)
    assert {"configure", "start", "read", "stop", "write", "reset", "run", "__exit__"} <= {*calls}
    for name in ("registers", "fifos"):
        assert isinstance(inspect.getattr_static(nifpga.Session, name), property)
    assert "no_run" in inspect.signature(nifpga.Session).parameters
    assert _FIFO.ReadValues._fields == simulated_card.ReadValues._fields


def test_the_recorder_loads_no_physics_and_no_jax():
    modules = "recorder", "simulated_card"
    code = "; ".join(f"import difffric.acquisition.{name}" for name in modules)
    loaded = subprocess.run(
        [sys.executable, "-c", f"{code}; import sys; print(*sys.modules)"],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    assert {"difffric.acquisition.stream", "difffric.measurements.recordings"} <= {*loaded}
    assert not {"jax", "equinox", "pydantic", "scipy", "polars"} & {*loaded}
    assert not [name for name in loaded if name.startswith(("difffric.rig", "difffric.simulation"))]


def test_no_driver_no_bitfile_or_no_card_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    with pytest.raises(df.InputError, match="NI's FPGA driver"):
        card.open_card("any.lvbitx")
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: "libNiFpga.so")
    with pytest.raises(df.InputError, match=r"expected --bitfile FILE\.lvbitx, got none"):
        card.open_card(None)
    with pytest.raises(df.InputError, match=r"gone\.lvbitx: no such file"):
        card.open_card(tmp_path / "gone.lvbitx")
    garbage = tmp_path / "garbage.lvbitx"
    garbage.write_text("no XML")
    with pytest.raises(df.InputError, match=r"garbage\.lvbitx: not a bitfile") as refused:
        card.open_card(garbage)
    assert "\n" not in str(refused.value)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """`run(...)`: `difffric acquire` with these arguments; programs are compiled once for all."""
    env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path_factory.mktemp("cache"))}

    def run_it(*arguments):
        command = [sys.executable, "-m", "difffric.commands.main", "acquire", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, env=env, timeout=300)

    return run_it


def test_the_command_records_the_pushes_that_the_model_makes(run, tmp_path):
    setup, out = tmp_path / "setup.toml", tmp_path / "out"
    setup.write_text(SETUP)
    speeds = ("--velocity-mm-min", 500, "--velocity-mm-min", 3000)
    done = run("--simulate", setup, *speeds, "--seed", 7, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "No stroke is given: 2 mm is commanded." in done.stdout
    assert {p.name for p in out.iterdir()} == {
        "pushes.tdms", "pushes.tdms_index", "report.html", "result.json", "strokes.png",
    }  # fmt: skip
    answer = json.loads((out / "result.json").read_text())
    assert answer["simulated"] and answer["rate_Hz"] == 10_000 and answer["lost_samples"] == 0
    rig = df.load_setup(setup)
    drawn = [push["simulated"]["mu_s"] for push in answer["pushes"]]
    assert drawn[0] != drawn[1] and max(abs(np.log(np.divide(drawn, 0.141)))) < 5 * 0.02
    for push, recording in zip(answer["pushes"], read_recordings(out / "pushes.tdms"), strict=True):
        trace = df.simulate(
            rig, push["velocity_m_per_s"], stroke=2e-3, mu_s=push["simulated"]["mu_s"]
        )
        assert push["simulated"]["peak_force_N"] == pytest.approx(float(trace.peak_force), rel=1e-6)
        force = recording.in_newtons(rig.force_sensor.sensitivity).force
        assert force.n == push["samples"]
        for channel, model, sigma in (
            (force, trace.force(force.time), 0.5),
            (recording.position, trace.position(recording.position.time), 0.3e-6),
        ):
            z = (channel.samples - np.asarray(model)) / sigma
            assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2 / len(z))
        assert float(trace.stop_time) < recording.position.time[-1] - 0.029


def test_the_command_takes_the_paper_s_speeds_twice_and_the_set_up_s_stroke(run, tmp_path):
    setup = tmp_path / "setup.toml"
    setup.write_text(SETUP + "[pusher]\nstroke_mm = 1.5\n")
    done = run("--simulate", setup, "--rate-hz", 2000, "--out", tmp_path, "--quiet")
    assert done.returncode == 0 and done.stderr == ""
    pushes = json.loads((tmp_path / "result.json").read_text())["pushes"]
    paper = from_mm_min(np.array([500, 1000, 2000, 3000, 4000, 5000] * 2))
    assert [push["velocity_m_per_s"] for push in pushes] == pytest.approx(paper)
    assert {push["stroke_m"] for push in pushes} == {1.5e-3}


def test_the_command_without_a_card_or_with_bad_numbers_is_one_line_and_status_2(run, tmp_path):
    setup, timed = tmp_path / "setup.toml", tmp_path / "timed.toml"
    setup.write_text(SETUP)
    timed.write_text(SETUP + "[pusher]\nduration_ms = 46\n")
    simulated = ("--simulate", setup, "--out", tmp_path / "out")
    for arguments, words in (
        ((), "use --simulate SETUP"),
        ((*simulated, "--velocity-mm-min", -1), "--velocity-mm-min: expected a number > 0"),
        ((*simulated, "--rate-hz", 0.5), "rate: expected a whole number of samples a second"),
        ((*simulated, "--velocity-mm-min", 1e9), "velocity: expected"),
        (("--simulate", timed, "--out", tmp_path / "out"), "give --stroke-mm"),
    ):
        if not arguments and ctypes.util.find_library("NiFpga"):
            continue
        done = run(*arguments)
        assert done.returncode == 2 and words in done.stderr
        assert done.stderr.count("\n") == 1 and done.stdout == ""
        assert not (tmp_path / "out" / "pushes.tdms").exists()
