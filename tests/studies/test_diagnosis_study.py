"""The study of diagnoses is done in parts: what is kept with the source is not done again."""

import json
import time
from functools import partial

import pytest

from studies import diagnosis as study
from studies import diagnosis_misses as misses
from studies import runs
from tests.hidden import random_case

CAUSE = {
    "id": "stribeck",
    "component": "friction",
    "confusable_with": [],
    "probability": 0.987654321,
    "parameters": {"v_s_m_per_s": {"value": 0.0123456789, "standard_error": 1e-4}},
    "chi2_drop": 40.0,
    "text": "friction falls with the speed",
}
LINE = {
    "group": "s = 6",
    "case": 3,
    "effects": {"stribeck": {"v_s_m_per_s": 0.0125}},
    "verdict": "named",
    "causes": [CAUSE],
    "considered": [CAUSE, {**CAUSE, "id": "gauge"}],
    "negligible": [],
    "plan": ["much that no figure reads"],
}


def test_a_case_is_kept_with_what_the_figures_read():
    short = study.shorten(LINE)
    assert "plan" not in short and "text" not in short["causes"][0]
    assert [x["id"] for x in short["considered"]] == ["stribeck"]
    assert short["causes"][0]["probability"] == 0.98765
    assert study.shorten(short) == short


def test_what_is_kept_is_not_done_again(tmp_path):
    done, kept = tmp_path / "done", tmp_path / "kept"
    kept.mkdir()
    (kept / "s = 6.jsonl").write_text(json.dumps(LINE) + "\n", encoding="utf-8")
    runs.add_missing(kept, done)
    asked = []
    runs.run("s = 6", done, 5, lambda i: asked.append(i) or {"case": i})
    assert asked == [0, 1, 2, 4]
    runs.add_missing(done, kept, partial(dict, told=True))
    there = runs.load(kept, "s = 6")
    assert [x["case"] for x in there] == [0, 1, 2, 3, 4]
    assert [x["case"] for x in there if "told" not in x] == [3]


def test_a_study_that_is_stopped_has_the_same_share_of_each_part():
    sizes = {"clean": 1000, "pairs": 200, "strong": 3}
    turns = list(runs.take_turns(sizes, 50))
    assert turns[:3] == [("clean", 20), ("pairs", 4), ("strong", 1)]
    assert dict(turns) == sizes and list(runs.take_turns(sizes, 1)) == list(sizes.items())


def test_a_study_of_no_rounds_is_refused(capsys):
    with pytest.raises(SystemExit) as stopped:
        runs.arguments("studies.x", "", ("clean",), runs.ROOT, ["--rounds", "0"])
    assert stopped.value.code == 2
    assert "--rounds: expected 1 or more, got 0" in capsys.readouterr().err


def test_a_room_that_no_diagnosis_enters_is_no_other_source(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "ROOT", tmp_path)
    for room in ("rig", "axis"):
        (tmp_path / "src" / "difffric" / room).mkdir(parents=True)
    (tmp_path / "src" / "difffric" / "units.py").write_text("GRAVITY = 9.8\n", encoding="utf-8")

    def code():
        return runs.code("hidden", ("rig",))

    before = code()
    (tmp_path / "src" / "difffric" / "axis" / "fit.py").write_text("x = 1\n", encoding="utf-8")
    assert code() == before
    (tmp_path / "src" / "difffric" / "rig" / "rig.py").write_text("x = 1\n", encoding="utf-8")
    changed = code()
    (tmp_path / "src" / "difffric" / "units.py").write_text("GRAVITY = 9.81\n", encoding="utf-8")
    assert len({before, changed, code()}) == 3


def test_every_process_of_a_study_keeps_to_a_core_of_its_own():
    assert [runs.pick_core((i, 3), [4, 2, 7]) for i in (1, 2, 3)] == [{2}, {4}, {7}]
    assert runs.pick_core((3, 3), [0, 1]) == {0}, "more processes than cores take turns"
    assert runs.pick_core((1, 1), [0, 1]) == {0, 1}, "alone it has all"


def test_a_case_whose_files_take_too_long_is_given_up(monkeypatch):
    case = random_case(1)
    monkeypatch.setitem(study.GROUPS, "clean", study.Group(1, 1, lambda i, seed: case))
    monkeypatch.setattr(study, "LONGEST_MAKING", 0.2)
    monkeypatch.setattr(study, "write", lambda case, folder: time.sleep(5))
    line = study.run_case("clean", 0)
    assert line == {"group": "clean", "case": 0, "skipped": "takes longer than 0.2 s"}


def test_what_went_wrong_is_listed_and_nothing_else():
    outside = {**LINE, "effects": {}, "outsider": {"soft_layer": {}}, "causes": [], "s": 40.0}
    outside |= {"components": ["contact"], "verdict": "unexplained", "location": "contact"}
    nothing = {**LINE, "effects": {}, "causes": [], "verdict": "adequate", "location": None}
    right = {"s = 6": [LINE], "outsiders, background": [outside], "clean": [nothing]}
    assert misses.markdown(right) == ""
    named = {**outside, "causes": [CAUSE], "verdict": "named", "location": None}
    elsewhere = [{**outside, "location": "pusher"}, named]
    wrong = {
        "s = 6": [{**LINE, "s": 6.01, "effects": {"tilt": {}}}],
        "outsiders, background": elsewhere,
        "clean": [{**nothing, "causes": [CAUSE], "verdict": "named"}],
    }
    assert misses.list_missed(wrong) == ["s = 6 3: tilt, s = 6.01: stribeck"]
    assert misses.list_misplaced(wrong) == [
        "outsiders, background 3: soft_layer: unexplained pusher",
        "outsiders, background 3: soft_layer: stribeck",
    ]
    assert misses.list_alarms(wrong) == ["clean 3: stribeck"]
