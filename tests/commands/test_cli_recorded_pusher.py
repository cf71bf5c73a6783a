"""Commands with a set-up that asks for the recorded pusher, and `simulate --motion` of pushes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from nptdms import ChannelObject, GroupObject, TdmsWriter

EXAMPLES = Path(__file__).parents[2] / "examples"
SPEED, STROKE, RATE = 0.05, 2e-3, 10e3
SETUP = """
[part]
mass_kg = 18.9
[friction]
mu_s = 0.141
k_v_N_s_per_m = 5.0
[contact]
k_N_per_m = 8.0e5
b_N_s_per_m = 1500.0
[pusher]
motion = "recorded"
stroke_mm = 2.0
[force_sensor]
noise_N = 0.5
[probe]
noise_um = 0.3
"""


@pytest.fixture
def setup(tmp_path):
    """A set-up that asks for the recorded pusher."""
    path = tmp_path / "setup.toml"
    path.write_text(SETUP, encoding="utf-8")
    return path


def write_tip(path, *, unit="um", end=0.1, name="pusher", bad=None):
    """One push whose tip keeps its speed, with noise of 0.3 um in it."""
    t = np.arange(-0.02, end, 1 / RATE) + 0.5 / RATE
    random = np.random.default_rng(0)
    y = 1e6 * np.clip(SPEED * t, 0, STROKE) + 0.3 * random.standard_normal(len(t))
    if bad is not None:
        y[bad] = np.nan
    waveform = {"wf_increment": 1 / RATE, "wf_start_offset": t[0], "wf_samples": len(t)}
    channels = {name: (unit, y), "force": ("N", 0.5 * random.standard_normal(len(t)))}
    with TdmsWriter(path) as file:
        file.write_segment(
            [
                GroupObject("push 1", {"velocity_mm_min": 3000.0, "stroke_mm": 2.0}),
                *(
                    ChannelObject("push 1", which, samples, {"unit_string": unit, **waveform})
                    for which, (unit, samples) in channels.items()
                ),
            ]
        )
    return path


def test_simulate_is_driven_by_the_tip_of_a_recording(run, setup, tmp_path):
    """F_p and d are those of the constant speed that the tip had, but for its noise."""
    tip = write_tip(tmp_path / "push.tdms")
    status, _, said = run("simulate", setup, "--motion", tip, "--out", tmp_path / "a", "--quiet")
    assert status == 0, said
    (push,) = json.loads((tmp_path / "a" / "result.json").read_text())["pushes"]
    speed = ["--velocity-mm-min", 3000, "--out", tmp_path / "b", "--quiet"]
    status, _, said = run("simulate", setup, *speed)
    assert status == 0, said
    constant = json.loads((tmp_path / "b" / "result.json").read_text())
    assert push["motion"]["end_s"] == pytest.approx(STROKE / SPEED, abs=3e-5)
    assert push["peak_force_N"] == pytest.approx(constant["peak_force_N"], rel=3e-3)
    assert push["sliding_distance_m"] == pytest.approx(constant["sliding_distance_m"], rel=1e-2)
    by = push["derivatives"]["peak_force_N"]
    assert by["mu_s"] == pytest.approx(constant["derivatives"]["peak_force_N"]["mu_s"], rel=2e-2)
    assert "velocity_m_per_s" not in by


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"name": "tip"}, "no channel pusher"),
        ({"unit": "mm"}, "is the channel's unit right?"),
        ({"end": 0.03}, "still moves where its recording ends"),
        ({"bad": 300}, "expected a finite number"),
    ],
)
def test_a_tip_that_cannot_be_used_is_one_line_and_nothing_is_written(
    run, setup, tmp_path, how, words
):
    tip, out = write_tip(tmp_path / "push.tdms", **how), tmp_path / "out"
    status, _, said = run("simulate", setup, "--motion", tip, "--out", out, "--quiet")
    assert status == 2 and words in said and not out.exists()
    assert len(said.strip().splitlines()) == 1


@pytest.mark.parametrize("command", ["fit", "identify", "check"])
def test_recordings_without_the_channel_are_refused(run, setup, command):
    status, _, said = run(command, EXAMPLES / "pushes.tdms", "--setup", setup, "--quiet")
    assert status == 2 and "no channel pusher" in said
    assert len(said.strip().splitlines()) == 1


def test_a_table_and_what_needs_constant_speed_are_refused(run, setup):
    for arguments in (
        ("fit", EXAMPLES / "pushes.csv", "--setup", setup, "--quiet"),
        ("monitor", EXAMPLES / "watched.csv", "--setup", setup, "--quiet"),
        ("simulate", setup, "--motion", EXAMPLES / "pushes.csv"),
        ("simulate", setup, "--motion", EXAMPLES / "pushes.tdms", "--velocity-mm-min", 3000),
    ):
        status, _, said = run(*arguments)
        assert status == 2 and len(said.strip().splitlines()) == 1, said
