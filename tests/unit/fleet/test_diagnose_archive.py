"""A fleet's diagnosis: what rigs share, which of them differ, and what is done again."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

import difffric as df
from difffric.commands.main import app
from difffric.commands.reports.fleet_diagnosis import (
    describe_fleet_diagnosis,
    report_fleet_diagnosis,
)
from difffric.commands.reports.page import render
from difffric.fleet import diagnose_archive, member
from difffric.fleet.archive import find_files
from difffric.fleet.diagnose_archive import diagnose_fleet
from difffric.fleet.meta_analysis import (
    compare_each_with_rest,
    correct_by_holm,
    count_sharing,
    find_odd_ones,
    pool,
    sum_evidence,
)
from difffric.fleet.sample import MOST, choose_over_speeds, sample
from difffric.fleet.shared_effects import SIGNIFICANT, combine, find_different
from difffric.fleet.verdict import FleetDiagnosis
from tests.browser import WIDTHS, browser, faults, needs_chromium
from tests.hidden import random_case, write
from tests.reference import data, files

__all__ = ["browser"]  # a fixture

SPEEDS = tuple(data.MM_MIN * v for v in (1000, 2000, 3000, 4000))
QUIET = ("tilt", "force_gain", "probe_scale", "quadratic_drag", "initial_gap")


# --- the statistics -------------------------------------------------------------------------------


def test_a_pooled_size_is_that_of_generalised_least_squares():
    rng = np.random.default_rng(1)
    for spread in (0.0, 3.0):
        s = rng.uniform(0.2, 1.0, 9)
        x = 5.0 + spread * rng.standard_normal(9) + s * rng.standard_normal(9)
        found = pool(x, s)
        C = np.diag(s**2 + found.between**2)
        A = np.ones((9, 1))
        information = A.T @ np.linalg.solve(C, A)
        value = np.linalg.solve(information, A.T @ np.linalg.solve(C, x))[0]
        assert found.value == pytest.approx(value, rel=1e-12)
        assert found.standard_error == pytest.approx(information[0, 0] ** -0.5, rel=1e-12)
        alone = np.average(x, weights=s**-2.0)
        assert found.q == pytest.approx((((x - alone) / s) ** 2).sum())
        assert found.p_value == pytest.approx(stats.chi2.sf(found.q, 8))
        if found.between:  # Paule and Mandel's condition
            left = (x - value) @ np.linalg.solve(C, x - value)
            assert left == pytest.approx(8, rel=1e-9)
    assert found.between == pytest.approx(3.0, rel=0.6)


def test_one_study_is_itself():
    found = pool([2.0], [0.5])
    assert (found.value, found.standard_error, found.between, found.p_value) == (2.0, 0.5, 0.0, 1.0)


def uniform(p):
    """Whether p-values are uniform."""
    return stats.kstest(p, "uniform").pvalue > 1e-3


def test_of_rigs_without_an_effect_the_summed_evidence_is_uniform():
    rng = np.random.default_rng(2)
    numbers = np.array([1, 1, 2, 1, 3, 1])
    drops = rng.chisquare(numbers, (3000, 6))
    assert uniform([sum_evidence(x, numbers) for x in drops])


def test_evidence_for_two_rigs_is_uniform_where_one_alone_has_the_effect():
    """However strong it is there; and no stronger claim is made oftener than its level."""
    rng = np.random.default_rng(3)
    drops = rng.chisquare(1, (3000, 6))
    drops[:, 2] += 1e4
    ones = np.ones(6)
    assert uniform([sum_evidence(x, ones, 2) for x in drops])
    assert np.mean([count_sharing(x, ones, 0.05) > 1 for x in drops]) < 0.06
    assert min(count_sharing(x, ones, 0.05) for x in drops[:50]) == 1
    assert sum_evidence([3.0], [1], 2) == 1.0


def test_weak_evidence_of_many_is_strong():
    drops, ones = np.full(12, 5.0), np.ones(12)
    assert stats.chi2.sf(5.0, 1) > 0.02 > 1e-4 > sum_evidence(drops, ones, 2)
    assert 2 <= count_sharing(drops, ones, 1e-3) < 12


@pytest.mark.parametrize("between", [0.0, 0.5, 3.0])
def test_what_the_others_foretell_of_a_study_is_right(between):
    """Whatever the studies differ by; where it is not seen for certain the test is milder."""
    rng, p = np.random.default_rng(4), []
    for _ in range(400):
        s = rng.uniform(0.5, 1.5, 8)
        p += compare_each_with_rest(
            between * rng.standard_normal(8) + s * rng.standard_normal(8), s
        )[:2].tolist()
    for level in (0.01, 0.05, 0.2):
        assert 0.3 * level - 0.002 < np.mean(np.array(p) < level) < 1.3 * level + 0.01


def test_of_studies_that_agree_none_is_odd():
    rng = np.random.default_rng(14)
    s = rng.uniform(0.5, 1.5, (250, 8))
    assert np.mean([bool(find_odd_ones(e * rng.standard_normal(8), e, 0.05)) for e in s]) < 0.09


def test_the_odd_one_is_found_and_no_other():
    rng = np.random.default_rng(5)
    s = np.full(6, 0.1)
    x = 1.0 + s * rng.standard_normal(6)
    x[3] += 1.0
    assert list(find_odd_ones(x, s, 0.01)) == [3]
    x[3], x[5] = x[3] + 40.0, x[5] + 3.0  # two, the second hidden by the first
    assert list(find_odd_ones(x, s, 0.01)) == [3, 5]
    assert find_odd_ones([1.0, 9.0], [0.1, 0.1], 0.01) == {}  # of two, neither
    s[3] = 50.0  # one that hardly knows
    assert 3 not in find_odd_ones(x, s, 0.01)


def test_holm():
    np.testing.assert_allclose(correct_by_holm([0.04, 0.01, 0.03]), [0.06, 0.03, 0.06])


# --- rigs' answers, made up -----------------------------------------------------------------------


def cause(effect, value=1.0, error=0.1, drop=60.0, alike=(), key="v_s_m_per_s"):
    return {
        "id": effect, "confusable_with": list(alike), "chi2_drop": drop,
        "parameters": {key: {"value": value, "standard_error": error}},
    }  # fmt: skip


def answer(rig, *causes, verdict=None, unseen=(), negligible=(), known=(), quiet=None):
    """A rig's answer as `fleet.member` keeps it; `quiet`: effect -> (where it leads, visible)."""
    evidence = {e: scored(0.0, 5.0) for e in QUIET}
    evidence["stribeck"] = {"chi2_drop": 0.0, "numbers": 1, "p_value": 1.0}
    evidence |= {e: scored(*x) for e, x in (quiet or {}).items()}
    for c in causes:
        p = float(stats.chi2.sf(c["chi2_drop"], 1))
        evidence[c["id"]] = {"chi2_drop": c["chi2_drop"], "numbers": 1, "p_value": p}
    said = verdict or ("named" if causes else "adequate")
    return {
        "rig": rig, "files": 3, "files_used": 3, "pushes": 20, "recordings": True, "left_out": [],
        "known": list(known),
        "evidence": {} if said == "unexplained" else evidence,
        "diagnosis": {
            "verdict": said, "causes": list(causes), "not_visible": list(unseen),
            "negligible": [{"id": e} for e in negligible],
            "location": "contact" if said == "unexplained" else None,
        },
    }  # fmt: skip


def scored(at, visible):
    """The score test of an effect of one number that leads to `at`."""
    drop = (at * visible) ** 2
    p = float(stats.chi2.sf(drop, 1))
    return {"chi2_drop": drop, "numbers": 1, "p_value": p, "at": at, "visible": visible}


def verdict(answers, excess=None, bad=()):
    found, excess = combine(answers), excess or {}
    by_rig = {a["rig"]: a for a in answers}
    differ = find_different(found, excess)
    return FleetDiagnosis(Path("out"), by_rig, found, excess, differ, tuple(bad))


def named(n, value=1.0, effect="stribeck", **more):
    return [answer(f"hall/{k}", cause(effect, value + 0.02 * k, **more)) for k in range(n)]


def test_seven_share_an_effect_and_one_lacks_it():
    fleet = verdict([*named(7), answer("hall/z")], {("stribeck", "hall/z"): 80.0})
    (one,) = fleet.found.shared
    assert one.effect == "stribeck" and len(one.rigs) == 7 and one.without == ("hall/z",)
    size = one.parameters["v_s_m_per_s"]
    assert size.value == pytest.approx(1.06) and size.standard_error == pytest.approx(0.1 / 7**0.5)
    (odd,) = fleet.differ
    assert (odd.rig, odd.how) == ("hall/z", "absent")
    assert odd.p_value == pytest.approx(stats.chi2.sf(80.0, 1))
    text = str(fleet)
    assert "7 of 8 rigs share stribeck (v_s_m_per_s = 1.060 ± 0.038)" in text
    assert "Rig hall/z differs: it has no stribeck" in text


def test_a_rig_that_could_not_show_an_effect_does_not_differ():
    for excess in ({}, {("stribeck", "hall/z"): 3.0}, {("stribeck", "hall/z"): -5.0}):
        fleet = verdict([*named(7), answer("hall/z", unseen=["stribeck"])], excess)
        assert fleet.found.shared[0].without == ("hall/z",) and not fleet.differ


def test_a_rig_whose_set_up_has_the_effect_does_not_lack_it():
    fleet = verdict([*named(3), answer("done", known=["stribeck"])])
    assert fleet.found.shared[0].without == () and not fleet.differ
    assert "it stands in the set-up of done already" in str(fleet)


def test_the_few_rigs_with_an_effect_do_not_make_the_many_differ():
    many = [answer(f"x/{k}") for k in range(6)]
    fleet = verdict([*named(2), *many], {("stribeck", f"x/{k}"): 90.0 for k in range(6)})
    assert not fleet.found.shared[0].common and not fleet.differ
    assert "2 of 8 rigs share stribeck" in str(fleet) and "hall/0, hall/1" in str(fleet)


def test_one_of_another_size_is_named_and_left_out_of_the_pooled_size():
    fleet = verdict([*named(5), answer("odd", cause("stribeck", 3.0))])
    (one,) = fleet.found.shared
    assert len(one.rigs) == 5 and list(one.odd) == ["odd"]
    assert one.parameters["v_s_m_per_s"].value == pytest.approx(1.04)
    (odd,) = fleet.differ
    assert (odd.rig, odd.how, odd.effect) == ("odd", "size", "stribeck") and odd.p_value < 0.01
    assert "its v_s_m_per_s of stribeck is 3.00 ± 0.10, the others' 1.040 ± 0.045" in str(fleet)


def test_sizes_that_all_differ_are_told_so_and_none_is_odd():
    values = [0.2, 1.1, 2.3, 3.0, 4.2]
    rigs = [answer(f"r{k}", cause("stribeck", x)) for k, x in enumerate(values)]
    fleet = verdict(rigs)
    size = fleet.found.shared[0].parameters["v_s_m_per_s"]
    assert not fleet.differ and size.p_value < 1e-3 and size.between > 1
    assert "its size differs from rig to rig" in str(fleet)


def test_a_cause_that_no_other_has_and_an_unexplained_misfit_differ():
    more = [answer("own", cause("tilt", key="alpha_rad")), answer("odd", verdict="unexplained")]
    fleet = verdict([*named(4), *more])
    assert [(x.rig, x.how) for x in fleet.differ] == [("own", "own"), ("odd", "unexplained")]
    assert "it alone has tilt (alpha_rad = 1.00 ± 0.10)" in str(fleet)
    assert "its misfit is unexplained, and sits in: contact" in str(fleet)


def test_rigs_that_tell_two_effects_apart_decide_for_those_that_do_not():
    one = answer("a", cause("friction_ratio", 0.8, alike=["tilt"], key="ratio"))
    two = [answer(x, cause("tilt", 0.01, 0.001, key="alpha_rad")) for x in ("b", "c")]
    (shared,) = combine([one, *two]).shared
    assert shared.effect == "tilt" and set(shared.rigs) == {"a", "b", "c"} and not shared.alike
    assert set(shared.sizes["alpha_rad"]) == {"b", "c"}  # what a says of its size is another's
    both = [answer(x, cause("tilt", alike=["friction_ratio"])) for x in ("b", "c")]
    assert combine([one, *both]).shared[0].alike == ("friction_ratio",)


def weak(rng, n, at, visible=4.0, effect="force_gain"):
    noise = rng.standard_normal(n) / visible
    return [answer(f"r{k:02d}", quiet={effect: (at + x, visible)}) for k, x in enumerate(noise)]


def test_an_effect_too_weak_to_be_named_in_any_rig_is_found_in_all():
    rng = np.random.default_rng(8)
    fleet = verdict(weak(rng, 12, at=0.6))  # 2.4 standard deviations each
    (one,) = fleet.found.shared
    assert one.effect == "force_gain" and one.by == "sum" and one.row.at_least >= 2
    assert one.row.p_value < one.row.p_value_two < SIGNIFICANT
    size = one.parameters["factor"]  # typical is 1.02, and none 1
    assert abs(size.value - 1.012) < 3 * size.standard_error < 0.02
    alone = 0.02 * 0.25 / 12**0.5
    assert size.standard_error == pytest.approx(np.hypot(alone, size.between / 12**0.5))
    assert "too weakly to be named in each" in str(fleet)


def test_nothing_is_shared_where_nothing_is_there():
    rng = np.random.default_rng(9)
    shared = [bool(combine(weak(rng, 8, at=0.0)).shared) for _ in range(60)]
    assert not any(shared)


def test_one_rig_cannot_speak_for_all():
    rigs = [*weak(np.random.default_rng(10), 7, at=0.0)]
    rigs.append(answer("strong", cause("force_gain", 1.1, drop=500.0, key="factor")))
    fleet = verdict(rigs)
    (row,) = [row for row in fleet.found.rows if row.effect == "force_gain"]
    assert row.p_value < 1e-90 and row.p_value_two > SIGNIFICANT and row.at_least == 1
    assert not fleet.found.shared
    assert [(x.rig, x.how) for x in fleet.differ] == [("strong", "own")]


def test_of_a_weak_effect_the_rig_of_another_size_differs_but_a_blind_one_does_not():
    rigs = weak(np.random.default_rng(11), 10, at=0.6)
    rigs.append(answer("none", quiet={"force_gain": (0.0, 40.0)}))
    rigs.append(answer("blind", quiet={"force_gain": (-9.0, 0.5)}))
    fleet = verdict(rigs)
    assert [(x.rig, x.how) for x in fleet.differ] == [("none", "size")]
    assert "blind" not in fleet.found.shared[0].sizes["factor"]


def test_what_is_written_is_whole_and_the_report_draws(tmp_path):
    for n in (1, 8, 50):
        rigs = [*named(max(n - 2, 1)), answer("z/odd", verdict="unexplained"), answer("z/a")]
        fleet = verdict(rigs[:n], {("stribeck", "z/a"): 50.0}, bad=[("broken", "no file")])
        told = describe_fleet_diagnosis(fleet)
        assert json.loads(json.dumps(told, allow_nan=False)) == told
        assert len(told["rigs"]) == n and told["bad"] == [{"rig": "broken", "reason": "no file"}]
        assert {"id", "named", "p_value", "at_least"} <= told["effects"][0].keys()
        page = render(report_fleet_diagnosis(fleet, pictures=n > 1))
        assert "1 rig could not be diagnosed: broken." in page
        if n == 1:
            assert "nothing can be compared" in page and not told["differ"]


@needs_chromium
@pytest.mark.parametrize("n", [8, 50])
def test_the_report_shows_at_both_widths(browser, tmp_path, n):
    rigs = [*named(n - 2), answer("z/odd", verdict="unexplained"), answer("z/a")]
    fleet = verdict(rigs, {("stribeck", "z/a"): 50.0}, bad=[("broken", "no file")])
    page = tmp_path / "report.html"
    page.write_text(render(report_fleet_diagnosis(fleet, pictures=True)), encoding="utf-8")
    for width in WIDTHS:
        assert faults(browser, page, width) == [], width


# --- files ----------------------------------------------------------------------------------------

RIG = data.Rig(12.0, 0.14, 0.75, 5.0, 6e5, 900.0, scatter=0.02)


def table(path, seed, n=6):
    rng = np.random.default_rng(seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write_table(path, data.measure(data.make_pushes(RIG, rng, n, SPEEDS), rng))


@pytest.fixture
def archive(tmp_path):
    """Three rigs with tables, one with a set-up that is none."""
    top = tmp_path / "archive"
    for k, name in enumerate(("a", "b", "c")):
        table(top / name / "pushes.csv", k)
        files.write_setup(top / name / "setup.toml", RIG)
    table(top / "bad/pushes.csv", 9)
    (top / "bad/setup.toml").write_text("nothing = 1\n")
    return top


def test_a_sample_is_bounded_spread_and_always_the_same(tmp_path):
    v = np.repeat([1.0, 2.0, 3.0], [100, 5, 60])
    keep = choose_over_speeds(v, 30)
    assert len(keep) == 30 and (np.diff(keep) > 0).all()
    assert [int((v[keep] == x).sum()) for x in (1, 2, 3)] == [13, 5, 12]
    assert keep[0] == 0 and keep[-1] == 164
    assert len(choose_over_speeds(np.linspace(1, 2, 500), 40)) == 40
    assert choose_over_speeds(v[:9], 30).tolist() == list(range(9))
    files.write_setup(tmp_path / "setup.toml", RIG)
    for day in range(4):
        table(tmp_path / f"day{day}.csv", day, 16)
    (tmp_path / "torn.csv").write_text("velocity_mm_min\nfast\n")
    one, two = sample(find_files(tmp_path)), sample(find_files(tmp_path))
    assert len(one.data) == MOST and one.notes == two.notes
    assert np.array_equal(one.data.peak_force, two.data.peak_force)
    assert (np.diff(one.data.order) > 0).all()
    assert any("40 of 64 pushes" in x for x in one.notes)
    assert any(x.startswith("torn.csv: ") for x in one.notes)


def test_recordings_go_before_tables_in_the_order_of_their_dates(tmp_path):
    rng = np.random.default_rng(15)
    files.write_setup(tmp_path / "setup.toml", RIG)
    table(tmp_path / "pushes.csv", 1)
    for day, when in (("new", 2e9), ("old", 1e9)):
        recorded = [data.record(p, rng) for p in data.make_pushes(RIG, rng, 3, SPEEDS)]
        files.write_recordings(tmp_path / f"{day}.tdms", recorded)
        os.utime(tmp_path / f"{day}.tdms", (when, when))
    one = sample(find_files(tmp_path))
    said = [df.load(tmp_path / f"{day}.tdms") for day in ("old", "new")]
    speeds = [p.velocity for part in said for p in part]
    assert [p.velocity for p in one.data] == speeds and one.files == 2
    assert [p.order for p in one.data] == list(range(6))
    assert any("tables are left out" in x for x in one.notes)


@pytest.fixture
def quick(monkeypatch):
    """Rigs that are examined at once: those with a name before c have stribeck. What was done."""
    done = []

    def examine(rig):
        done.append(rig.name)
        if rig.name == "dies":
            return "its pushes could not be followed"
        made = answer(rig.name, *[cause("stribeck", 0.02, 0.001)] * (rig.name < "c"))
        Path(rig.folder).mkdir(parents=True, exist_ok=True)
        (Path(rig.folder) / member.SETUP).write_text("")
        member._save_answer(Path(rig.folder) / member.RESULT, rig.key, made)

    def ask(question):
        done.append((question.effect, question.rig.name))
        member._save_answer(question.path, question.key, {"excess": 40.0})

    monkeypatch.setattr(diagnose_archive, "examine", examine)
    monkeypatch.setattr(diagnose_archive, "ask", ask)
    return done


def test_a_second_run_does_only_what_is_missing_or_has_changed(archive, tmp_path, quick):
    out = tmp_path / "out"

    def run():
        quick.clear()
        return diagnose_fleet(archive, out)

    first = run()
    assert quick == ["a", "b", "c", ("stribeck", "c")] and first.fresh == 3 and first.asked == 1
    assert [(x.rig, x.how) for x in first.differ] == [("c", "absent")]
    (bad,) = first.bad
    assert bad[0] == "bad" and "nothing" in bad[1]
    again = run()
    assert quick == [] and (again.fresh, again.asked) == (0, 0)
    assert describe_fleet_diagnosis(again) == describe_fleet_diagnosis(first)
    table(archive / "c/more.csv", 12)
    run()
    assert quick == ["c", ("stribeck", "c")]
    table(archive / "b/pushes.csv", 13, 7)
    run()  # the size that c is held against is the same
    assert quick == ["b"]
    files.write_setup(archive / "a/setup.toml", replace(RIG, m=12.5))
    run()
    assert quick == ["a"]
    (out / "rigs/b/result.json").write_text('{"torn')
    run()
    assert quick == ["b"]
    shutil.rmtree(archive / "a")
    (out / "rigs/mine").mkdir()
    (out / "rigs/mine/result.json").write_text("{}")
    run()
    assert quick == [] and sorted(x.name for x in (out / "rigs").iterdir()) == ["b", "c", "mine"]


def test_a_rig_that_cannot_be_diagnosed_is_listed_and_tried_again(archive, tmp_path, quick):
    table(archive / "dies/pushes.csv", 20)
    files.write_setup(archive / "dies/setup.toml", RIG)
    for _ in range(2):
        quick.clear()
        found = diagnose_fleet(archive, tmp_path / "out")
        assert "dies" in quick
        assert dict(found.bad)["dies"] == "its pushes could not be followed"


def test_what_nobody_foresaw_in_one_rig_stops_no_other(archive, tmp_path, monkeypatch):
    def fails(setup, some, **options):
        raise RuntimeError("a program could\nnot be compiled")

    monkeypatch.setattr(member, "diagnose", fails)
    with pytest.raises(df.InputError, match="a: RuntimeError: a program could not be compiled"):
        diagnose_fleet(archive, tmp_path / "out")


def command(*words):
    return CliRunner().invoke(app, ["diagnose", *map(str, words), "--quiet"])


def test_the_command_prints_and_writes(archive, tmp_path, quick):
    out = tmp_path / "out"
    ended = command(archive, "--out", out)
    assert ended.exit_code == 0, ended.output
    assert "2 of 3 rigs share stribeck (v_s_m_per_s = 0.02000 ± 0.00071)" in ended.output
    told = json.loads((out / "result.json").read_text())
    assert told["shared"][0]["without"] == [{"rig": "c", "excess": 40.0}]
    assert told["rigs"][0]["result"] == "rigs/a/result.json"
    assert (out / told["rigs"][0]["result"]).is_file()
    assert (out / "effects.png").is_file() and "effects" in (out / "report.html").read_text()


def test_one_rig_has_nothing_to_be_compared_with(archive, tmp_path, quick):
    ended = command(archive / "a", "--out", tmp_path / "out")
    assert ended.exit_code == 0 and "nothing can be compared" in ended.output


def problem(*words):
    """The one line of an input error."""
    ended = command(*words)
    assert isinstance(ended.exception, df.InputError), ended.output
    text = str(ended.exception)
    assert "\n" not in text
    return text


def test_bad_input_is_one_clear_line(archive, tmp_path, quick):
    out = tmp_path / "out"
    (tmp_path / "empty").mkdir()
    assert "--out is missing" in problem(archive)
    assert "found none" in problem(tmp_path / "empty", "--out", out)
    both = ("--workers", "2", "--scheduler", "tcp://x:1")
    assert "give one of them" in problem(archive, "--out", out, *both)
    assert "--setup is missing" in problem(archive / "a/pushes.csv")
    assert "held_out" in problem(archive, "--out", out, "--held-out", "day")
    alone = problem(archive / "bad", "--out", out)
    assert "none of 1 rigs can be diagnosed: .:" in alone
    assert not out.exists()


# --- end to end -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_three_rigs_share_a_hidden_effect_and_the_fourth_is_named(tmp_path):
    """Tables of four rigs, all different; the probes of three are 10 % off."""
    factor = 1.1
    for name, seed in {"a": 2, "b": 3, "c": 4, "d": 5}.items():
        case = random_case(seed, kind="table", scatter=0.003)
        if name != "d":
            case = case.with_effect("probe_scale", {"factor": factor})
        write(case, tmp_path / "archive" / name)
    found = diagnose_fleet(tmp_path / "archive", tmp_path / "out")
    (one,) = found.found.shared
    assert one.effect == "probe_scale" and set(one.rigs) == {"a", "b", "c"}
    size = one.parameters["factor"]
    assert abs(size.value - factor) < 3 * size.standard_error
    assert [(x.rig, x.how) for x in found.differ] == [("d", "absent")]
    again = diagnose_fleet(tmp_path / "archive", tmp_path / "out")
    assert again.fresh == again.asked == 0
    assert describe_fleet_diagnosis(again) == describe_fleet_diagnosis(found)
