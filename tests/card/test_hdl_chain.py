"""The whole chain: rig, converter and encoder, the core in GHDL, its FIFOs' words, the emulated
driver, nifpga, `acquire`, a .tdms, `identify`. The friction that went in comes out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import difffric as df
from difffric.acquisition.card import METRES_PER_COUNT, VOLTS_PER_WORD, split_position
from difffric.acquisition.push import Command
from difffric.acquisition.recorder import acquire
from difffric.identification.live import find_contradictions
from difffric.measurements.checks import check_data
from difffric.measurements.files.tdms_reader import read_recordings
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.rig.setup_toml import read_setup
from difffric.studies.simulated_rig import SimulatedRig
from fpga.emulator.emulator import emulated_card
from tests.card.hdl import simulate
from tests.compiler import needs_compiler

pytestmark = [needs_compiler, simulate.needs("ghdl")]

SETUP = read_setup(Path(__file__).parents[2] / "examples" / "setup.toml")
RATE = 10_000
QUIET, REST = 0.02, 0.03  # [s], which `acquire` records around a push
COMMAND = Command(velocity=0.035, stroke=0.6e-3, mass=18.9)
LATE = 2 / RATE  # [s] by which the latch may be early or late: the force is below its 2 N for less


def conversions(command, average_log2, seed):
    """(mu_s, force words, encoder counts) of each conversion, the counts from anywhere."""
    random = np.random.default_rng(seed)
    pushed = SimulatedRig(replace(SETUP, mu_s_scatter=0.1), seed)  # not the set-up's own mu_s
    evaluate, end = pushed(command.velocity, command.stroke)
    n = 2**average_log2
    samples = round((QUIET + REST) * RATE) + int(np.ceil(end * RATE))
    # The first of a sample's conversions to its last are centred where that sample is dated.
    t = (np.arange(samples * n) + 0.5) / (n * RATE) - QUIET
    force, position = evaluate(t)
    sensor, probe = SETUP.rig.force_sensor, SETUP.rig.probe
    # Of a sample, the position has the set-up's noise; between samples it turns smoothly.
    jitter = np.interp(t, t[n // 2 :: n], probe.noise * random.standard_normal(samples))
    force = force + np.sqrt(n) * sensor.noise * random.standard_normal(len(t))
    words = np.rint(force * sensor.sensitivity / VOLTS_PER_WORD)
    counts = np.rint((position + jitter) / METRES_PER_COUNT) + random.integers(-5000, 5000)
    return pushed.truth[0]["mu_s"], words.astype(int), counts.astype(int)


@pytest.mark.parametrize("average_log2", [0, 2])
def test_the_friction_that_goes_in_comes_out(tmp_path, average_log2):
    mu_s, words, counts = conversions(COMMAND, average_log2, seed=average_log2 + 1)
    np.savez(tmp_path / "push.npz", words=words, counts=counts, average_log2=average_log2)
    failed = simulate.run(
        "tests.card.hdl.push_replay", tmp_path, environment={"REPLAY": str(tmp_path)}
    )
    assert failed == {"replay": ""}
    core = json.loads((tmp_path / "core.json").read_text())
    says = core["says"]
    force, position = (np.array(column) for column in zip(*core["words"], strict=True))
    number, count = split_position(position)
    assert list(number) == list(range(len(words) // 2**average_log2))
    assert says["done"] and says["samples"] == says["streamed"] == len(number)

    path, emulated = tmp_path / "pushes.tdms", {}
    with emulated_card(rate=RATE) as card:
        card.add_push(force, count)
        with card.open() as session:
            (push,) = acquire(session, [COMMAND], path, quiet=QUIET, rest=REST)
            emulated = {name: int(session.registers[name].read()) for name in says}
    assert (push.samples, push.lost, push.fault) == (len(number), 0, "")
    # To the last bit: the emulator's registers are the core's, and the recorded words say the same.
    assert emulated == says
    assert push.hardware.agrees and push.hardware.released
    hardware = push.hardware
    seen = hardware.peak_word, hardware.release_sample, hardware.release_count
    assert seen == (says["peak_word"], says["release_sample"], says["release_count"])

    recordings = check_data(read_recordings(path), SETUP.rig)
    reduction = reduce_recordings(recordings)
    (reduced,) = reduction.details
    # What docs/acquire.md asks of peak and latch; and from the latch to rest it is the
    # reduction's d, but for how far the part goes meanwhile.
    assert find_contradictions(push, recordings[0], reduced, SETUP.rig) == ()
    rest = count[number * (1 / RATE) > number[-1] / RATE - REST / 2].mean()
    distance = METRES_PER_COUNT * (rest - says["release_count"])
    noise = 5 * SETUP.rig.probe.noise
    assert abs(distance - reduced.sliding_distance) < LATE * reduced.release_velocity + noise

    (found,) = df.identify(SETUP.rig, df.load(path))
    for way in (found.mu_s_force, found.mu_s_distance, found.mu_s_optimal):
        assert way.value is not None and way.standard_error is not None
        assert abs(way.value - mu_s) < 4 * way.standard_error < 0.1 * mu_s
