"""The study's figures are what was asked for, and its arithmetic is right."""

import json
import math
from functools import partial

import numpy as np
import pytest

from studies import calibration as study
from studies import calibration_figures as figures
from studies import runs


def line(case=0, z=(0.0, 0.0, 0.0, 0.0), *, worse=0.0, apart=0.0, converged=True, notes=()):
    """A case whose four values are z standard errors of 1 off a truth of 10, se known."""
    names = figures.LABELS
    return {
        "case": case,
        "truth": dict.fromkeys(names, 10.0),
        "parameters": {
            name: {"value": 10 + x, "se": 1.0, "low": 10 + x - 1.96, "high": 10 + x + 1.96}
            for name, x in zip(names, z, strict=True)
        },
        "converged": converged,
        "notes": list(notes),
        "misfit": 100.0 + worse,
        "from_truth": {"misfit": 100.0, "apart": apart},
        "own_mu_s_z": [0.0] * 14,
        "seconds": 1.0,
    }


def normal_lines(n, scale=1.0, seed=1):
    """n fits whose errors are `scale` times what they say."""
    z = scale * np.random.default_rng(seed).standard_normal((n, 4))
    return [line(i, z[i]) for i in range(n)]


def test_shares_count_what_they_say():
    lines = [line(0, (0, 1.9, 2.5, 3.5)), line(1, (-1, -2, -2.9, -3.1))]
    assert figures.within_3(lines) == (6, 8)
    assert figures.coverage(lines)[0] == (3, 8)
    assert figures.coverage(lines, ("mu_s",))[0] == (0, 2)


def test_a_fit_that_failed_has_no_parameter_within_3_standard_errors():
    assert figures.within_3([line(), {"case": 1, "error": "no"}]) == (4, 8)


def test_a_parameter_at_its_bound_has_no_interval_and_is_counted_apart():
    bound = line()
    bound["parameters"]["mu_s"] = {"value": 10.0, "se": None, "low": None, "high": None}
    assert figures.coverage([bound])[0] == (3, 3)
    assert figures.at_bound([bound]) == {"mu_s": 1}


def test_honest_errors_pass_and_errors_20_per_cent_too_small_do_not():
    assert figures.complaints({"tables": normal_lines(1000)}) == []
    found = figures.complaints({"tables": normal_lines(1000, 1.25)})
    assert sum("intervals" in x for x in found) == 5


def test_coverage_of_one_parameter_is_tested_exactly():
    lines = [line(i, (0, 0, 0, 5.0 * (i < 10))) for i in range(100)]
    share, p = figures.coverage(lines, ("mu_s",))
    # P(at most 90 of 100 | 0.95) = 0.0282; as unlikely or more on the other side: 99 and 100
    # of 100 are likelier than 90 of 100 (0.0312 and 0.0059: the latter is not).
    assert share == (90, 100)
    assert p == pytest.approx(0.02819 + 0.00592, abs=2e-5)


def test_coverage_of_several_does_not_take_one_rigs_parameters_for_independent():
    together = [line(i, (5.0 * (i < 32),) * 4) for i in range(400)]
    p_one, p_all = (figures.coverage(together, x)[1] for x in (("mu_s",), figures.LABELS))
    assert 0.5 * p_one < p_all < 2 * p_one


@pytest.mark.parametrize(
    "case, right, said",
    [
        (line(), True, False),
        (line(worse=-5.0, apart=9.0), True, False),  # better than from the truth
        (line(worse=5.0, apart=0.01), True, False),  # at the same place
        (line(worse=5.0, apart=9.0), False, False),
        (line(worse=5.0, apart=9.0, converged=False), False, True),
        (line(worse=5.0, apart=9.0, notes=["chi-square is 9 times"]), False, True),
        ({"case": 0, "error": "no start gives a finite misfit"}, False, True),
    ],
)
def test_right_optimum_is_no_worse_than_from_the_truth(case, right, said):
    assert figures.reached(case) == right
    assert figures.said_so(case) == said


def test_wrong_and_silent_fits_are_named():
    lines = [*normal_lines(99), line(77, worse=5.0, apart=9.0)]
    assert any("do not say so: [77]" in x for x in figures.complaints({"tables": lines}))


def test_a_page_keeps_its_text_and_has_one_table():
    once = runs.into("# Study\n\nWords.\n", "first")
    again = runs.into(once, "second")
    assert again.startswith("# Study\n\nWords.\n")
    assert "second" in again and "first" not in again
    assert runs.into(again, "second") == again


def test_cases_are_drawn_from_their_own_seed():
    rig, guess, pushes, data = study.draw("tables", 3)
    again = study.draw("tables", 3)
    assert again[:2] == (rig, guess)
    assert [p.mu_s for p in again[2]] == [p.mu_s for p in pushes]
    np.testing.assert_array_equal(again[3].peak_force, data.peak_force)
    assert study.draw("tables", 4)[0] != rig
    assert study.draw("spreads", 3)[0] != rig


def test_the_study_runs_is_resumed_and_passes_over_a_line_cut_short(tmp_path):
    one = partial(study.run_case, "tables")
    runs.run("tables", tmp_path, 3, one, (3, 3))  # case 2 alone
    path = tmp_path / "tables.jsonl"
    first = path.read_text()
    (found,) = runs.load(tmp_path, "tables")
    assert "error" not in found and found["converged"] and figures.reached(found)
    assert all(math.isfinite(found["parameters"][name]["se"]) for name in figures.LABELS)
    assert json.loads(first)["truth"] == study.true_values(study.draw("tables", 2)[0])
    path.write_text(first + first[:50])
    runs.run("tables", tmp_path, 3, one, (3, 3))
    assert path.read_text() == first + first[:50]
    runs.run("tables", tmp_path, 4, lambda case: {"case": case}, (4, 4))  # on a line of its own
    assert [line["case"] for line in runs.load(tmp_path, "tables")] == [2, 3]
    text = figures.markdown({"tables": [found]}, "code")
    assert "| rigs | 1 |" in text


@pytest.mark.slow
def test_the_figures_asked_for_are_met():
    folder = runs.RESULTS / runs.code("reference")
    lines = {kind: runs.load(folder, kind) for kind in study.KINDS}
    if not any(lines.values()):
        pytest.skip("no results of this source: python -m studies.calibration makes them")
    assert figures.complaints(lines) == []


def test_a_law_changed_two_folders_down_is_another_source(tmp_path, monkeypatch):
    law = tmp_path / "src" / "difffric" / "rig" / "laws" / "friction.py"
    law.parent.mkdir(parents=True)
    law.write_text("mu_k = 0.75\n", encoding="utf-8")
    monkeypatch.setattr(runs, "ROOT", tmp_path)
    before = runs.code("reference")
    law.write_text("mu_k = 0.76\n", encoding="utf-8")
    changed = runs.code("reference")
    law.rename(law.with_name("contact.py"))
    assert len({before, changed, runs.code("reference")}) == 3


def test_words_about_a_law_are_no_other_source(tmp_path, monkeypatch):
    law = tmp_path / "src" / "difffric" / "rig" / "friction.py"
    law.parent.mkdir(parents=True)
    monkeypatch.setattr(runs, "ROOT", tmp_path)

    def code_of(text):
        law.write_text(text, encoding="utf-8")
        return runs.code("reference")

    plain = code_of('RATIO = 0.75\n\ndef slide(n):\n    return RATIO * n, "N"\n')
    worded = code_of(
        '"""A law."""\nRATIO = 0.75\n"""of mu_k to mu_s"""\n\ndef slide(n):\n'
        '    """The force."""\n    return (  # of Coulomb\n        RATIO * n, "N"\n    )\n'
    )
    assert worded == plain
    assert code_of('RATIO = 0.75\n\ndef slide(n):\n    return RATIO * n, "kN"\n') != plain
