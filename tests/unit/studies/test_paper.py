"""The paper's numbers, its misprints, and what the model says of its measurements."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import difffric as df
from difffric.commands.reports.page import write_folder
from difffric.commands.reports.paper import report_paper
from difffric.identification.surrogates import PUBLISHED_DISTANCE, PUBLISHED_FORCE, weigh_by_ranges
from difffric.rig import parameters
from difffric.simulation.columns import observe_columns
from difffric.simulation.families import family
from difffric.studies import paper, published_tables
from difffric.units import from_mm_min
from tests.browser import WIDTHS, browser, faults, needs_chromium

__all__ = ["browser"]  # a fixture


@pytest.fixture(scope="module")
def study():
    return paper.study()


def test_23_of_24_printed_values_follow_from_their_formulas():
    rows = [r for r in published_tables.read_tables() if r.measured is not None]
    assert len(rows) == 24
    (misprint,) = published_tables.find_misprints()
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
    grid = family(published_tables.guess_rig())
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
    """Wrecking the judged speed's measurements leaves the calibration that judges it unchanged."""
    measured = study.pushes
    folds = np.unique(measured.velocity, return_inverse=True)[1]
    start = study.explanation.list_blind(study.explanation.best)[3]
    wrecked = replace(
        measured,
        peak_force=np.where(folds == 3, 2.0, 1.0) * measured.peak_force,
        sliding_distance=np.where(folds == 3, 3.0, 1.0) * measured.sliding_distance,
    )
    fits = [
        df.fit(
            study.explanation.extend_setup(start),
            paper.hide(given, folds == 3, folds == 3),
            several_starts=False,
        )
        for given in (measured, wrecked)
    ]
    np.testing.assert_array_equal(*(one.theta for one in fits))


def test_what_the_search_adds_to_the_spring_mends_what_no_k_b_and_k_v_can(study):
    """The loss on rebound, the tip that goes on, the latch, and friction that falls with speed."""
    assert study.explanation.best.parts == {
        "rebound_damping", "pusher_duration", "release_latch", "stribeck",
    }  # fmt: skip
    errors = [stage["heldout_nrmse"] for stage in study.list_stages()]
    assert errors == sorted(errors, reverse=True) and errors[-1] < 0.1 * errors[0]
    fit = study.extended.fit
    assert len(fit.free) <= 6
    for name in fit.free:
        assert fit.standard_error(name) < fit.value(name)
    F, d = (
        np.array([m[f"{name}_extended"] for m in study.misfit()])
        for name in ("peak_force_residual_N", "sliding_distance_residual_m")
    )
    assert np.sqrt(np.mean(F**2)) < 6.0 and np.sqrt(np.mean(d**2)) < 70e-6


def test_mu_s_of_a_speed_that_was_left_out(study):
    """The figures that the report leads with, and none out of reach."""
    errors = {(e["condition"], e["by"]): e for e in study.list_errors()}
    for condition, by_force in (("DRY", 16.0), ("OILY", 28.0)):
        assert errors[condition, "force"]["model"] < by_force
        assert errors[condition, "distance"]["model"] < 8.0
        assert all(
            errors[condition, by]["answered"] == 6
            for by in ("force", "distance", "equation (7)", "optimal")
        )
    fastest = [r for r in study.list_weighted() if r["velocity_mm_min"] == 5000]
    assert all(abs(r["mu_s_model"] / r["mu_s_gauge"] - 1) < 0.02 for r in fastest)


def test_forces_alone_give_equation_3(study):
    """Without damping on approach C_v and C_mu come out; a damper takes dF_p/dmu_s away."""
    slopes = {s["model"]: s for s in study.compare_slopes()}
    assert study.by_force.value("b_N_s_per_m") < 1e-3 * study.plain.fit.value("b_N_s_per_m")
    assert slopes["forces"]["C_v_N_min_per_mm"] == pytest.approx(PUBLISHED_FORCE.C_v, rel=0.02)
    assert slopes["forces"]["C_mu_N"] == pytest.approx(PUBLISHED_FORCE.C_mu, rel=0.02)
    assert slopes["plain"]["slope_N"][-1] < 0.5 * slopes["forces"]["slope_N"][-1]


def test_a_push_that_tells_rivals_apart_is_one_in_which_they_differ(study):
    """What the report proposes, by an answer of the model itself."""
    one = study.proposals[0]
    best = study.extended.fit.rig
    other = study.explanation.extend_setup(study.explanation.rivals[0]).rig
    d = [
        observe_columns(
            parameters.with_values(rig, {"mu_s": one.mu_s}), from_mm_min(one.velocity_mm_min)
        ).sliding_distance.item()
        for rig in (best, other)
    ]
    sd = np.hypot(15e-6, 0.02 * d[0])
    assert one.after == pytest.approx(abs(d[0] - d[1]) / np.sqrt(2) / sd, rel=1e-6)
    for proposal in study.proposals[1:]:
        assert proposal.after < proposal.before


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
    assert {cause["id"] for cause in diagnosis["causes"]} == study.explanation.best.parts
    assert len(diagnosis["certificates"]) == 4
    assert diagnosis["gain"]["heldout_nrmse_after"] < diagnosis["gain"]["heldout_nrmse_before"]
    for name in ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m"):
        assert set(answer["calibration"]["parameters"][name]) >= {"value", "standard_error"}
    page = (tmp_path / "report.html").read_text()
    assert "http" not in page.replace("http://www.w3.org", "")
    for figure in (
        "figure_II_3",
        "figure_II_4",
        "figure_II_5",
        "figure_II_6",
        "explained",
        "errors",
        "slopes",
    ):
        assert (tmp_path / f"{figure}.png").stat().st_size > 10_000


@needs_chromium
def test_the_report_shows_at_both_widths(browser, study, tmp_path):
    write_folder(tmp_path, study.as_dict(), report_paper(study))
    for width in WIDTHS:
        assert faults(browser, tmp_path / "report.html", width) == [], width
