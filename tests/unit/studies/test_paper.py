"""The paper's numbers, its misprints, and what the model says of its measurements."""

from __future__ import annotations

import json

import numpy as np
import pytest

import difffric as df
from difffric.commands.reports.page import write_folder
from difffric.commands.reports.paper import report_paper
from difffric.identification.surrogates import PUBLISHED_DISTANCE, PUBLISHED_FORCE, weigh_by_ranges
from difffric.simulation.families import family
from difffric.studies import paper
from difffric.units import from_mm_min
from tests.browser import WIDTHS, browser, faults, needs_chromium

__all__ = ["browser"]  # a fixture


@pytest.fixture(scope="module")
def study():
    return paper.study()


def test_23_of_24_printed_values_follow_from_their_formulas():
    rows = [r for r in paper.read_tables() if r.measured is not None]
    assert len(rows) == 24
    (misprint,) = paper.find_misprints()
    assert (misprint["table"], misprint["velocity_mm_min"], misprint["printed"]) == (
        "IV",
        1000,
        0.193,
    )
    # Its own printed error of -29.5 % says the same.
    assert misprint["recomputed"] == pytest.approx(0.135 * (1 - 0.295), abs=0.002)


def test_the_surrogates_are_the_printed_equations():
    assert float(PUBLISHED_FORCE.mu_s(from_mm_min(500), 46.1)) == pytest.approx(
        (46.1 - 0.0529 * 500) / 146.2
    )
    d = 0.3415 - np.sqrt((8175 - 0.00041 * 5000**1.8997) / (0.07379 * 5000**1.6428))
    assert float(PUBLISHED_DISTANCE.mu_s(from_mm_min(5000), 8175e-6)) == pytest.approx(d)


def test_the_surrogates_invert_themselves():
    v, mu = np.meshgrid(from_mm_min(np.linspace(500, 5000, 7)), np.linspace(0.05, 0.3, 6))
    for s, forward in ((PUBLISHED_FORCE, "peak_force"), (PUBLISHED_DISTANCE, "sliding_distance")):
        np.testing.assert_allclose(s.mu_s(v, getattr(s, forward)(v, mu)), mu, rtol=1e-12)
        h = 1e-6
        slope = (getattr(s, forward)(v, mu + h) - getattr(s, forward)(v, mu - h)) / (2 * h)
        np.testing.assert_allclose(s.slope(v, mu), slope, rtol=1e-6)


def test_weights_stay_between_0_and_1_because_magnitudes_are_meant():
    value, w_F, w_d = weigh_by_ranges(0.14, 0.13, 146.0, -0.03, 4e4)
    assert 0 < w_F < 1 and w_F + w_d == 1 and 0.13 < value < 0.14


def test_equation_3_is_what_the_spring_and_damper_give():
    """F_p = mu_k F_N + v sqrt(k m) without damping, wherever the part slips at once... or not."""
    rig = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=0.0, mu_k_over_mu_s=1.0)
    v = 0.05
    expected = 0.141 * 18.9 * 9.80665 + v * np.sqrt(8e5 * 18.9)
    assert float(df.observe(rig, v).peak_force) == pytest.approx(expected, rel=1e-12)


def test_the_fits_find_a_family_that_is_one_of_theirs():
    grid = family(paper.guess_rig())
    v, mu = np.meshgrid(grid.velocity, grid.mu_s, indexing="ij")
    force = type(PUBLISHED_FORCE).fit(v, mu, PUBLISHED_FORCE.peak_force(v, mu))
    assert vars(force) == pytest.approx(vars(PUBLISHED_FORCE), rel=1e-9)
    other = type(PUBLISHED_DISTANCE)(mu_0=0.40, C_1=0.0008, k1=1.8, C_2=0.05, k2=1.7)
    d = other.sliding_distance(v, mu)
    d[0, :3] = np.nan
    assert vars(type(other).fit(v, mu, d)) == pytest.approx(vars(other), rel=1e-4)


def test_no_fit_without_points():
    with pytest.raises(df.NumericalError, match="4 pushes that slide"):
        type(PUBLISHED_DISTANCE).fit(np.full(4, 0.05), np.full(4, 0.1), np.full(4, 1e-3))


def test_four_measured_distances_are_beyond_any_k_b_and_k_v(study):
    beyond = {(m["condition"], m["velocity_mm_min"]) for m in study.misfit() if m["unreachable"]}
    assert beyond == {("DRY", 500), ("DRY", 1000), ("OILY", 500), ("OILY", 1000)}
    bounds = [round(m["lossless_bound_m"] * 1e6) for m in study.misfit() if m["unreachable"]]
    assert bounds == [134, 536, 140, 560]


def test_no_speed_is_judged_by_a_calibration_that_saw_it(study):
    """Wrecking the judged speed's other measurements leaves its own answer unchanged."""
    measured = paper.load_pushes()
    judged = measured.velocity == measured.velocity[3]
    impossible = measured.sliding_distance > paper.bound_distance(measured)
    blind = df.fit(
        paper.guess_rig(),
        paper._hide(measured, judged, impossible | judged).select(~judged),
    )
    ratio = study.families.range_ratio
    answer = df.identify(blind, measured.select(judged), range_ratio=ratio)
    for mine, theirs in zip(
        answer, [study.identified[i] for i in np.flatnonzero(judged)], strict=True
    ):
        assert mine.mu_s_distance.value == pytest.approx(theirs.mu_s_distance.value, rel=1e-4)
        assert mine.mu_s_force.value == pytest.approx(theirs.mu_s_force.value, rel=1e-3)


def test_the_answer_has_the_contract_s_fields(study, tmp_path):
    write_folder(tmp_path, study.as_dict(), report_paper(study))
    answer = json.loads((tmp_path / "result.json").read_text())
    rows = answer["rows"]
    assert [r["table"] for r in rows] == ["I"] * 6 + ["II"] * 6 + ["III"] * 6 + ["IV"] * 6
    assert [r["velocity_mm_min"] for r in rows[:6]] == [500, 1000, 2000, 3000, 4000, 5000]
    fields = {
        "table", "condition", "velocity_mm_min", "mu_s_gauge", "mu_s_printed",
        "error_percent_printed", "mu_s_surrogate", "mu_s_model", "mu_s_model_standard_error",
        "reason",
    }  # fmt: skip
    for r in rows:
        assert fields <= set(r)
        assert (r["mu_s_model"] is None) == (r["reason"] is not None)
    assert len(answer["weighted"]) == 12
    diagnosis = answer["diagnosis"]
    assert diagnosis["verdict"] == "ambiguous" and len(diagnosis["certificates"]) == 4
    for name in ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m"):
        assert set(answer["calibration"]["parameters"][name]) >= {"value", "standard_error"}
    page = (tmp_path / "report.html").read_text()
    assert "http" not in page.replace("http://www.w3.org", "")
    for figure in (
        "figure_II_3",
        "figure_II_4",
        "figure_II_5",
        "figure_II_6",
        "residuals",
        "identified",
    ):
        assert (tmp_path / f"{figure}.png").stat().st_size > 10_000


@needs_chromium
def test_the_report_shows_at_both_widths(browser, study, tmp_path):
    write_folder(tmp_path, study.as_dict(), report_paper(study))
    for width in WIDTHS:
        assert faults(browser, tmp_path / "report.html", width) == [], width


def test_from_the_distance_the_model_beats_the_paper_where_it_can_reach(study):
    """2000 mm/min and above, on speeds not calibrated on: what the report's first line says."""
    rows = [
        r for r in study.list_rows() if r["table"] in ("III", "IV") and r["velocity_mm_min"] >= 2000
    ]
    ours = np.array([abs(r["mu_s_model"] / r["mu_s_gauge"] - 1) for r in rows])
    theirs = np.array([abs(r["error_percent_printed"]) / 100 for r in rows])
    assert ours.max() < 0.06 and ours.mean() < 0.3 * theirs.mean()
