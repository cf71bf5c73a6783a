"""What a command shows while it works: what it does, how far it is, and what remains."""

from __future__ import annotations

import json
import sys
import time
from io import StringIO

import pytest
from rich.console import Console

from difffric.commands.running import durations, progress_display
from difffric.commands.running.durations import PastRun, keep_durations, name_work, read_course
from difffric.commands.running.progress_display import ProgressDisplay
from difffric.commands.running.remaining_time import (
    RemainingTime,
    format_duration,
    format_remaining,
)
from difffric.compute.programs.record import Record

BEFORE = PastRun((0.0, 0.1, 0.2, 1.0), (0.0, 90.0, 95.0, 100.0))
"""Work of which the second tenth took a twentieth of the time, and the first nine tenths."""


@pytest.fixture
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv(durations.CACHE, str(tmp_path))
    return tmp_path


def test_what_went_as_before_ends_as_before():
    remaining = RemainingTime(BEFORE)
    for share, now in ((0.0, 0.0), (0.1, 90.0), (0.2, 95.0)):
        remaining.tell(share, now)
        assert remaining.estimate(now) == pytest.approx(100.0 - now)
    assert remaining.estimate(97.0) == pytest.approx(3.0)


def test_within_a_part_the_time_goes_down_and_a_part_that_takes_longer_slows_all():
    remaining = RemainingTime(BEFORE)
    remaining.tell(0.0, 0.0)
    left = [remaining.estimate(float(now)) for now in range(0, 90, 10)]
    assert left == pytest.approx([100.0 - now for now in range(0, 90, 10)])
    assert remaining.estimate(180.0) == pytest.approx(10.0 * 185.0 / 95.0)


def test_work_at_half_the_pace_takes_twice_as_long_yet():
    remaining = RemainingTime(PastRun((0.0, 0.5, 1.0), (0.0, 1000.0, 2000.0)))
    remaining.tell(0.5, 2000.0)
    assert remaining.estimate(2000.0) == pytest.approx(2000.0, rel=0.01)


def test_without_a_last_time_the_pace_says_what_remains_once_there_is_one():
    remaining = RemainingTime()
    remaining.tell(0.05, 20.0)
    assert remaining.estimate(20.0) is None
    remaining.tell(0.25, 30.0)
    assert remaining.estimate(30.0) == pytest.approx(90.0)
    assert remaining.estimate(50.0) == pytest.approx(70.0)
    remaining.tell(0.2, 60.0)  # a share that falls is no progress
    assert remaining.estimate(60.0) == pytest.approx(60.0)
    assert remaining.estimate(230.0) == pytest.approx(100.0)  # what goes on goes on


def test_a_course_holds_when_each_share_was_done_first():
    remaining = RemainingTime()
    for share, now in ((0.0, 1.0), (0.3, 2.0), (0.1, 3.0), (0.3, 4.0), (1.0, 5.0)):
        remaining.tell(share, now)
    assert remaining.end(6.0) == PastRun((0.0, 0.3, 1.0), (0.0, 2.0, 6.0))


@pytest.mark.parametrize(
    ("seconds", "duration", "remaining"),
    [
        (3.2, "3 s", "a few seconds left"),
        (42.0, "42 s", "about 40 s left"),
        (129.0, "2 min 9 s", "about 2 min 10 s left"),
        (600.0, "10 min", "about 10 min left"),
        (7290.0, "2 h 2 min", "about 2 h 2 min left"),
    ],
)
def test_times_are_told_no_finer_than_they_are_known(seconds, duration, remaining):
    assert format_duration(seconds) == duration and format_remaining(seconds) == remaining


def test_a_course_is_kept_for_work_of_its_kind_and_size(cache, tmp_path):
    data = tmp_path / "data.csv"
    data.write_bytes(b"x" * 1000)
    words = ["fit", str(data), "--robust", "--out", "somewhere"]
    work = name_work(words)
    keep_durations(work, False, BEFORE, {"a.b": 2.5})
    assert read_course(name_work(["fit", str(data), "--out=else", "--robust"]), False) == BEFORE
    assert read_course(work, True) is None
    assert read_course(name_work(["fit", str(data), "--out", "x"]), False) is None
    data.write_bytes(b"x" * 4000)
    assert read_course(name_work(words), False) is None
    assert durations.read_compile_times() == {"a.b": 2.5}
    assert "data.csv" not in (cache / "durations.json").read_text()


@pytest.mark.parametrize("kept", ["", "[]", '{"courses": 3}', '{"courses": {"fit 2^0": {}}}'])
def test_what_cannot_be_read_is_as_if_it_had_not_been_kept(cache, kept):
    (cache / "durations.json").write_text(kept)
    assert read_course("fit 2^0", False) is None and durations.read_compile_times() == {}
    keep_durations("fit 2^0", False, BEFORE, {})
    assert read_course("fit 2^0", False) == BEFORE


def test_only_the_newest_kinds_of_work_are_kept(cache):
    for i in range(110):
        keep_durations(f"fit {i}", False, BEFORE, {})
    assert len(json.loads((cache / "durations.json").read_text())["courses"]) == 100
    assert read_course("fit 9", False) is None and read_course("fit 10", False) == BEFORE


def test_a_log_gets_a_line_now_and_then_and_standard_output_nothing(cache, monkeypatch, capsys):
    monkeypatch.setattr(progress_display, "_FIRST", 0.2)
    monkeypatch.setattr(progress_display, "_NEXT", 0.2)
    file = StringIO()
    with ProgressDisplay(["fit"], False, Console(file=file, force_terminal=False)) as display:
        display.tell("settling", 0.4)
        time.sleep(0.7)
    lines = file.getvalue().splitlines()
    assert 2 <= len(lines) <= 4
    assert all(line.startswith("difffric: settling: 40 %, ") for line in lines)
    assert capsys.readouterr() == ("", "")


def test_who_asks_for_quiet_sees_nothing(cache, monkeypatch):
    monkeypatch.setattr(progress_display, "_FIRST", 0.01)
    file = StringIO()
    for terminal in (True, False):
        console = Console(file=file, force_terminal=terminal)
        with ProgressDisplay(["fit"], True, console) as display:
            display.tell("settling", 0.4)
            time.sleep(0.1)
    assert file.getvalue() == ""


def test_a_terminal_shows_what_is_done_how_far_and_what_remains(cache):
    keep_durations("fit 2^0", False, BEFORE, {})
    console = Console(file=StringIO(), force_terminal=True, color_system=None)
    display = ProgressDisplay(["fit"], False, console)
    display.tell("step 1 of 7: fitting", 0.0)
    with console.capture() as shown:
        console.print(display._render())
    what, bar = shown.get().splitlines()
    assert what == "step 1 of 7: fitting"
    assert bar.endswith("  0 %  0 s so far, about 1 min 40 s left")


def test_what_is_compiled_is_told_with_how_long_it_took_the_last_time(cache, monkeypatch):
    name = "difffric.estimation.extended_model._answer"
    slow = PastRun((0.0, 1.0), (0.0, 500.0))
    keep_durations("fit 2^0", False, BEFORE, {name: 62.0})
    keep_durations("fit 2^0", True, slow, {})
    monkeypatch.setattr(progress_display, "UNDER_WAY", under_way := [])
    display = ProgressDisplay(["fit"], True, Console(file=StringIO()))
    display.tell("fitting the plain rig", 0.0)
    assert display.describe()[0] == "fitting the plain rig"
    under_way.append((Record(name, ""), time.perf_counter() - 12.0))
    what, times = display.describe()
    assert what == (
        "fitting the plain rig; compiling the rig with every effect (12 s, 1 min 2 s the last time)"
    )
    assert times.endswith("about 8 min left")  # by the last time that it compiled


def test_what_ended_early_is_not_kept_as_how_long_it_takes(cache, monkeypatch):
    monkeypatch.setattr(durations, "_LEAST", 0.0)
    with pytest.raises(ValueError, match="early"), ProgressDisplay(["fit"], True, Console()):
        raise ValueError("early")
    assert read_course("fit 2^0", False) is None
    with ProgressDisplay(["fit"], True, Console(file=sys.stderr)) as display:
        display.tell("settling", 0.5)
    course = read_course("fit 2^0", False)
    assert course is not None and course.shares == (0.0, 0.5, 1.0)
