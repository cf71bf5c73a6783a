"""What is shown and said of pushes while they come."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from difffric.acquisition.hardware_check import Hardware
from difffric.acquisition.push import Acquired, Command
from difffric.commands.figures.acquire import draw_strokes, find_envelope
from difffric.commands.figures.live_view import LivePlot, LiveView
from difffric.identification.estimates import NONE, Estimate, PushFriction
from difffric.identification.live import LivePush, find_contradictions
from difffric.identification.tabulated_model import TabulatedModel, _observe_chunk
from difffric.measurements.recordings import Channel, Recording
from difffric.measurements.reduction.reduce import Reduced
from difffric.rig import parameters
from difffric.rig.setup_toml import read_setup

COMMAND = Command(0.05, 1.2e-3, 18.9)
HARDWARE = Hardware(5272, True, 600, 50_000, False, 0, False, True)
ACQUIRED = Acquired("push_0001", COMMAND, 10_000, 2000, 0, HARDWARE)
FRICTION = PushFriction(
    0.05, "", "released_by_rebound", Estimate(0.1203, 0.0011), Estimate(0.12001, 0.00003), NONE,
    Estimate(0.12002, 0.00003), None, (), None, None,
)  # fmt: skip
REDUCED = Reduced(
    peak_force=143.4, peak_force_se=0.1, peak_time=4e-3, sliding_distance=4.4e-3,
    sliding_distance_se=1e-6, release_time=0.04, release_time_se=1e-5,
)  # fmt: skip
FOUND = LivePush(ACQUIRED, FRICTION, REDUCED, None, (), 0.031)
LOST = replace(ACQUIRED, name="push_0002", lost=12, hardware=replace(HARDWARE, agrees=None))


def recording(name="push_0001", n=2000):
    t = -0.02 + 1e-4 * np.arange(n)
    force = 143.0 * np.sin(np.pi * np.clip(t / 0.04, 0, 1))
    channels = (Channel.of(force, 1e-4, -0.02, "N"), Channel.of(t, 1e-4, -0.02, "m"))
    return Recording(0.05, *channels, mass=18.9, stroke=1.2e-3, name=name)


def shown(terminal: bool, quiet: bool = False) -> str:
    file = io.StringIO()
    console = Console(file=file, force_terminal=terminal, width=180, highlight=False)
    with LiveView(identified=True, quiet=quiet, console=console) as view:
        view.tell("push 1 of 2", 0.0)
        view.add(ACQUIRED, FOUND)
        view.add(LOST, LivePush(LOST, None, None, "12 samples lost", (), 0.002))
    return file.getvalue()


def test_a_push_is_a_line_where_there_is_no_terminal():
    first, second = shown(terminal=False).splitlines()
    assert first.startswith("push_0001, 3000 mm/min, 2000 samples, F_p 143.4 N, d 4400 µm")
    assert "mu_s: force 0.1203 ± 0.0011" in first and first.endswith("after 31 ms")
    assert second == "push_0002, 3000 mm/min, 2000 samples, after 2 ms, 12 samples lost"


def test_a_push_is_a_row_on_a_terminal_and_nothing_where_that_was_asked_for():
    table = shown(terminal=True)
    assert "push 1 of 2" in table and "mu_s: force" in table and "0.120020 ± 0.000030" in table
    assert "after [ms]" in table and "F_p [N]" in table
    assert "12 samples lost" in table
    assert shown(terminal=True, quiet=True) == shown(terminal=False, quiet=True) == ""


def test_the_live_figure_is_written_anew_after_each_push(tmp_path):
    plot = LivePlot(tmp_path)
    sizes = []
    for found in (FOUND, LivePush(LOST, None, None, "lost", (), 0.0), None):
        plot.add(found, recording())
        written = (tmp_path / "live.png").read_bytes()
        assert written[:4] == b"\x89PNG"
        sizes.append(len(written))
    assert len(set(sizes)) > 1 and [p.name for p in tmp_path.iterdir()] == ["live.png"]


def test_two_strokes_stand_one_after_the_other():
    figure = draw_strokes([recording(), recording("push_0002")])
    lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) > 2]
    ends = [(float(np.min(x)), float(np.max(x))) for x in (line.get_xdata() for line in lines)]
    assert len(ends) == 2 and ends[0][1] <= ends[1][0] and ends[1][1] == pytest.approx(399.9)
    _, drawn = find_envelope(recording(n=1_000_000).force)
    assert len(drawn) <= 8000 and drawn.max() == pytest.approx(143.0, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, ""),
        ({"peak_word": 5200}, "held a peak"),
        ({"peak_word": 5400}, "held a peak"),
        ({"release_sample": 700}, "latched the loss of contact at 0.05 s"),
        ({"released": False}, "saw no loss of contact"),
    ],
)
def test_the_reduction_checks_what_the_card_saw(change, words):
    rig = read_setup("examples/setup.toml").rig
    acquired = replace(ACQUIRED, hardware=replace(HARDWARE, **change))
    found = find_contradictions(acquired, recording(), REDUCED, rig)
    assert bool(found) == bool(words) and words in "; ".join(found)


def test_mu_s_from_a_curve_gives_back_what_was_measured():
    rig = parameters.with_stroke(read_setup("examples/setup.toml").rig, 1.2e-3)
    curve = TabulatedModel.of(rig, 0.02)
    random = np.random.default_rng(0)
    for i in random.integers(300, 900, 20):
        for which, quantity in enumerate(("peak_force", "sliding_distance")):
            value, after = curve.both[which, i : i + 2]
            target = value + 0.3 * (after - value)
            if not np.isfinite(target) or value == after:
                continue
            found = curve.invert(target, quantity)
            roots = np.array(found.alternatives or [found.value])
            size = np.resize(roots, 512)
            model = _observe_chunk(curve.rig, np.full(512, 0.02), size, curve.integrator)[which]
            assert np.allclose(model[: len(roots)], target, rtol=1e-9)
            assert np.any((roots > curve.mu_s[i]) & (roots < curve.mu_s[i + 1]))
    for target, words in ((np.nan, "no peak force was measured"), (1e6, "above the most")):
        assert words in curve.invert(target, "peak_force").reason
