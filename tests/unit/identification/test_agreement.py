"""A whole recording that the model does not follow does not decide the friction of its push."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import difffric as df
from difffric.calibration.identifiability import identifiable
from difffric.commands.reports.check import examine, report_check
from difffric.commands.reports.identify import describe_friction, report_friction
from difffric.identification.agreement import describe_agreement, judge_recording
from difffric.identification.estimates import NONE, Estimate, PushFriction
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.rig.setup import Setup
from tests.reference import traces

RATE, SPEED, STROKE = 250.0, 2e-4, 1.4e-3
RIG = {"mass": 0.1, "k": 1000.0, "b": 2.0, "k_v": 0.0, "mu_k_over_mu_s": 0.8, "stroke": STROKE}


def record_break_aways(creep, n=4, seed=1, damping=2.0):
    """(recordings, each one's mu_s) of a block that breaks away behind a spring of 1000 N/m at
    0.2 mm/s; its probe sees it creep this far [m] before, which the model does not know."""
    rng, found, mu_s = np.random.default_rng(seed), [], []
    for i in range(n):
        mu_s.append(1.07 * np.exp(0.005 * rng.standard_normal()))
        course = traces.follow(0.1, mu_s[-1], 0.8, 0.0, 1000.0, damping, SPEED, STROKE)
        t = np.arange(-0.5, course.end + 0.5, 1 / RATE) + 0.7e-3
        force, x, _ = course(t)
        share = np.clip(force / course.peak_force, 0, 1)
        x = x + creep * np.clip((share - 0.7) / 0.3, 0, 1) ** 2
        read = (
            Channel.of(y + noise * rng.standard_normal(len(t)), 1 / RATE, t[0], unit)
            for y, noise, unit in ((force, 2e-3, "N"), (x, 3e-7, "m"))
        )
        found.append(Recording(SPEED, *read, mass=0.1, stroke=STROKE, name=f"push {i + 1}"))
    return Recordings(tuple(found)), np.array(mu_s)


def test_the_mean_of_break_aways_holds_the_truth_though_the_position_creeps():
    recordings, mu_s = record_break_aways(4e-4)
    rig = df.spring_damper_rig(**RIG, mu_s=1.0)
    found = df.identify(rig, recordings)
    astray = found.values("mu_s_trace") / mu_s - 1
    assert (np.abs(astray) > 0.02).all()  # what all samples say is wrong by far
    mean = describe_friction(found, rig)["conditions"][""]
    assert abs(mean["mean"] - mu_s.mean()) < 2 * mean["standard_error"] < 0.02
    for push in found:
        assert push.best_way == "mu_s_optimal" and abs(push.trace_disagreement) > 3
        assert "does not fit" in push.reason and "passed over" in push.reason
    assert "4 of 4 whole recordings do not fit" in found.notes[0]
    assert "differ by more than three" in found.notes[1]
    assert describe_friction(found, rig)["notes"] == list(found.notes)
    report = report_friction(found, describe_friction(found, rig), recordings, pictures=False)
    assert any("do not fit" in line for line in report.summary)
    assert "reduced chi²" in report.sections[0].tables[0].columns


def test_recordings_that_the_model_follows_are_taken_as_they_are():
    recordings, mu_s = record_break_aways(0.0, n=2)
    found = df.identify(df.spring_damper_rig(**RIG, mu_s=1.0), recordings)
    assert {push.best_way for push in found} == {"mu_s_trace"}
    np.testing.assert_allclose(found.values("mu_s_trace"), mu_s, rtol=1e-4)
    assert not any("fit" in note for note in found.notes)


def test_a_part_that_stays_in_contact_is_told_alike_by_all():
    """One reason in result.json, of a recording that shows it, and one sentence on the screen."""
    recordings, _ = record_break_aways(0.0, n=2, damping=60.0)
    rig = df.spring_damper_rig(**{**RIG, "b": 60.0}, mu_s=1.0)
    found = df.identify(rig, recordings)
    assert [push.reason for push in found] == 2 * ["rests in contact"]
    report = report_friction(found, describe_friction(found, rig), recordings, pictures=False)
    table = report.sections[0].tables[0]
    assert table.caption == "mu_s of each push; the best estimate: whole recording"
    assert "rests in contact" not in table.rows[0][-1]
    setup = Setup(rig)
    checked = examine(recordings, setup)
    told = report_check(checked, identifiable(rig, checked.pushes), setup, pictures=False)
    assert told.sections[1].tables[0].rows[0][-1] == table.rows[0][-1]


def push(trace, chi2, optimal=NONE):
    """What a push said by its whole recording, and by force and distance."""
    empty = (None, NONE, NONE, NONE, optimal, None, (), None, None)
    return PushFriction(0.05, "", *empty, mu_s_trace=trace, trace_reduced_chi2=chi2)


def test_a_recording_alone_is_kept_with_the_error_that_its_misfit_gives():
    """sqrt((4 * 3e-4)^2 + 5e-4^2): the noise's part grows, the calibration's does not."""
    one = Estimate(0.9, float(np.hypot(3e-4, 5e-4)), (5e-4,))
    kept = judge_recording(push(one, 16.0), 3e-4)
    assert kept.best.value == 0.9
    assert kept.best.standard_error == pytest.approx(1.3e-3)
    assert "widened 4 times" in kept.reason
    (note,) = describe_agreement([kept])
    assert "chi-square up to 16, push 1" in note and "kept with a wider error" in note


def test_ways_differ_by_what_they_do_not_share():
    """The calibration's error, the same in both, cannot set them apart: 4e-3 / 5e-4 = 8."""
    shared = (0.01,)
    a, b = (Estimate(x, float(np.hypot(s, 0.01)), shared) for x, s in ((0.9, 3e-4), (0.896, 4e-4)))
    found = judge_recording(push(a, 1.0, b), 3e-4)
    assert found.trace_disagreement == pytest.approx(8.0)
    assert found.best is found.mu_s_trace and found.reason is None
    assert len(describe_agreement([found])) == 1
    assert not describe_agreement([replace(found, trace_disagreement=2.9)])
