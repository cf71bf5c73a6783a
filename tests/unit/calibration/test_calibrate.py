"""Calibration on independent data: what was put in comes out, as far as the error bars say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import difffric as df
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.rig.sensors import ForceSensor
from difffric.rig.setup import Extras, Setup
from tests.reference import data as reference

PRACTICE = Path(__file__).parents[3] / ".." / "shared" / "data" / "practice"
TRUE = reference.Rig(
    m=18.9, mu_s=0.141, ratio=0.75, k_v=8.0, k=8.0e5, b=1500.0, scatter=0.02, stroke=2e-3
)
FREE = {"k_N_per_m": "k", "b_N_s_per_m": "b", "k_v_N_s_per_m": "k_v", "mu_s": "mu_s"}


def rough(k=3.0, b=1 / 3, mu_s=0.5):
    """A guess that is off by these factors."""
    return df.spring_damper_rig(
        mass=TRUE.m, mu_s=mu_s * TRUE.mu_s, k=k * TRUE.k, b=b * TRUE.b, k_v=5.0,
        force_sensor=ForceSensor(range=5000.0),
    )  # fmt: skip


def recorded(pushes, rng, **options):
    """The pushes as recordings in memory."""
    out = []
    for p in pushes:
        x = reference.record(p, rng, **options)
        channels = [
            Channel.of(y, x.dt, x.start, unit) for y, unit in ((x.force, "N"), (x.position, "m"))
        ]
        out.append(Recording(p.velocity, *channels, stroke=p.stroke, condition=p.condition))
    return Recordings(tuple(out))


def z_scores(fit, rig=TRUE):
    """(found - true) / standard error of k, b, k_v, mu_s."""
    return np.array(
        [(fit.value(x) - getattr(rig, y)) / fit.standard_error(x) for x, y in FREE.items()]
    )


@pytest.fixture(scope="module")
def pushes():
    return reference.make_pushes(TRUE, np.random.default_rng(11))


@pytest.fixture(scope="module")
def table(pushes):
    return df.Pushes(**reference.measure(pushes, np.random.default_rng(12)))


@pytest.fixture(scope="module")
def fit_of_table(table):
    return df.fit(rough(), table)


@pytest.fixture(scope="module")
def white(pushes):
    return recorded(pushes, np.random.default_rng(13))


@pytest.fixture(scope="module")
def fit_of_recordings(white):
    return df.fit(rough(), white)


def test_a_table_gives_the_rig_back_from_a_start_three_times_off(fit_of_table, pushes):
    assert fit_of_table.converged
    assert np.abs(z_scores(fit_of_table)).max() < 3.5
    own = (fit_of_table.mu_s - [p.mu_s for p in pushes]) / fit_of_table.mu_s_se
    assert np.abs(own).max() < 4
    assert fit_of_table.scatter == pytest.approx(TRUE.scatter, abs=4 * fit_of_table.scatter_se)


def test_the_start_does_not_matter(fit_of_table, table):
    other = df.fit(rough(k=1 / 3, b=3.0, mu_s=2.0), table)
    for label in FREE:
        error = fit_of_table.standard_error(label)
        assert other.value(label) == pytest.approx(fit_of_table.value(label), abs=0.01 * error)


def test_recordings_give_the_rig_back_to_parts_in_ten_thousand(fit_of_recordings, pushes):
    fit = fit_of_recordings
    assert fit.converged
    assert np.abs(z_scores(fit)).max() < 3.5
    assert fit.standard_error("k_N_per_m") < 1e-4 * TRUE.k
    assert fit.reduced_chi2 == pytest.approx(1.0, abs=0.1)
    own = (fit.mu_s - [p.mu_s for p in pushes]) / fit.mu_s_se
    assert np.abs(own).max() < 4.5


def test_one_start_finds_what_all_find_where_the_model_is_right(fit_of_recordings, white):
    one = df.fit(rough(), white, thorough=False)
    assert one.converged and one.starts_at_optimum == (1, 1)
    for label in FREE:
        error = fit_of_recordings.standard_error(label)
        assert one.value(label) == pytest.approx(fit_of_recordings.value(label), abs=0.01 * error)


def test_correlated_noise_widens_the_error_bars_and_the_truth_stays_inside(
    fit_of_recordings, pushes
):
    noise = reference.Noise(rho=0.9)
    fit = df.fit(rough(), recorded(pushes, np.random.default_rng(14), noise=noise))
    assert fit.noise["force"]["correlation"] == pytest.approx(0.9, abs=0.05)
    assert np.abs(z_scores(fit)).max() < 4
    # n AR(1) samples are worth n (1 - phi) / (1 + phi) for what changes slowly.
    phi = fit.noise["force"]["correlation"]
    slow = np.sqrt((1 + phi) / (1 - phi))
    louder = (
        fit.noise["force"]["standard_deviation"]
        / fit_of_recordings.noise["force"]["standard_deviation"]
    )
    for label in ("k_N_per_m", "b_N_s_per_m"):
        ratio = fit.standard_error(label) / fit_of_recordings.standard_error(label)
        assert 2 < ratio < 1.1 * slow * louder


@pytest.mark.slow
def test_start_offsets_are_found_where_they_are_free(pushes):
    offsets = np.random.default_rng(3).normal(0, 20e-6, len(pushes))
    late = [
        replace(r, **{c: replace(getattr(r, c), start=getattr(r, c).start + t) for c in CHANNELS})
        for r, t in zip(recorded(pushes, np.random.default_rng(13)), offsets, strict=True)
    ]
    late = Recordings(tuple(late))
    blind, free = df.fit(rough(), late), df.fit(rough(), late, free_start=True)
    assert np.sqrt(np.mean((free.start - offsets) ** 2)) < 2e-6
    assert free.reduced_chi2 < 1.1 < blind.reduced_chi2
    assert np.abs(z_scores(free)).max() < 4
    with pytest.raises(df.InputError, match="only recordings have a start offset"):
        df.fit(rough(), df.Pushes([0.05], [174.0], [3.5e-3]), free_start=True)


CHANNELS = ("force", "position")


@pytest.mark.slow
def test_conditions_have_their_own_mu_s():
    rng = np.random.default_rng(5)
    oily = replace(TRUE, mu_s=0.11)
    both = [
        *reference.make_pushes(TRUE, rng, n=7, condition="DRY"),
        *reference.make_pushes(oily, rng, n=7, condition="OILY"),
    ]
    fit = df.fit(rough(), df.Pushes(**reference.measure(both, rng)))
    assert set(fit.free) == {*FREE, "mu_s[DRY]", "mu_s[OILY]"} - {"mu_s"}
    for label, true in (("mu_s[DRY]", 0.141), ("mu_s[OILY]", 0.11)):
        assert fit.value(label) == pytest.approx(true, abs=3.5 * fit.standard_error(label))
    shared = df.fit(rough(), df.Pushes(**reference.measure(both, rng)), per_condition=())
    assert shared.free == tuple(FREE) and shared.scatter > 3 * fit.scatter


def test_an_outlier_weighs_less_in_a_robust_fit(table):
    F = table.peak_force.copy()
    F[3] += 40.0
    spoilt = replace(table, peak_force=F)
    plain, robust = df.fit(rough(), spoilt), df.fit(rough(), spoilt, robust=True)

    def k_error(fit):
        return abs(fit.value("k_N_per_m") / TRUE.k - 1)

    assert k_error(robust) < 0.3 * k_error(plain)


def test_a_gauge_leaves_neither_scatter_nor_a_free_mu_s(pushes, table):
    known = replace(table, mu_s_gauge=np.array([p.mu_s for p in pushes]))
    fit = df.fit(rough(mu_s=1.0), known)
    assert "mu_s" not in fit.free and fit.scatter == 0
    for label in fit.free:
        true = getattr(TRUE, FREE[label])
        assert fit.value(label) == pytest.approx(true, abs=3.5 * fit.standard_error(label))


def test_bounds_hold_and_priors_pull(table):
    extras = {"k_N_per_m": Extras(lower=8.1e5)}
    bounded = df.fit(Setup(rough(), None, extras), table)
    assert bounded.value("k_N_per_m") == pytest.approx(8.1e5)
    assert bounded.held == ("k_N_per_m",)
    assert {"parameters": ["k_N_per_m"], "reason": "at its lower bound, 810000"} in (
        bounded.not_identifiable
    )
    sure = Setup(rough(k=1.1), None, {"k_N_per_m": Extras(standard_error=1.0)})
    assert df.fit(sure, table, priors=True).value("k_N_per_m") == pytest.approx(1.1 * TRUE.k, 1e-4)
    assert df.fit(sure, table).value("k_N_per_m") == pytest.approx(TRUE.k, rel=0.02)


def test_what_the_set_up_says_is_not_free_stays():
    lay = {"b_N_s_per_m": Extras(free=False), "mu_k_over_mu_s": Extras(free=True)}
    pushes = df.Pushes(
        **reference.measure(reference.make_pushes(TRUE, np.random.default_rng(2)),
                            np.random.default_rng(3))
    )  # fmt: skip
    rig = rough(b=1.0)
    fit = df.fit(Setup(rig, None, lay), pushes)
    assert fit.free == ("k_N_per_m", "k_v_N_s_per_m", "mu_s", "mu_k_over_mu_s")
    assert float(fit.rig.contact.b) == TRUE.b
    with pytest.raises(df.InputError, match="mass_kg is said by the data"):
        df.fit(rig, replace(pushes, mass=np.full(len(pushes), 18.9)), free=("mass_kg",))


def test_free_slides_give_mu_s_and_its_scatter():
    rng = np.random.default_rng(8)
    rig = replace(TRUE, scatter=0.05)
    slides = reference.measure_slides(rig, rng, n=30, slowest=0.05, fastest=0.5)
    fit = df.fit(rough(mu_s=2.0), df.Pushes(**slides.columns))
    for label in fit.free:
        true = getattr(rig, FREE[label])
        assert fit.value(label) == pytest.approx(true, abs=3.5 * fit.standard_error(label))
    assert fit.scatter == pytest.approx(0.05, abs=4 * fit.scatter_se)
    answer = df.identify(fit, df.Pushes(**slides.columns))
    z = (answer.values("mu_s_slide") - slides.mu_s) / answer.standard_errors("mu_s_slide")
    assert np.abs(z).max() < 4.5 and np.std(z) < 1.5


def test_every_way_to_mu_s_agrees_with_its_error_bar(fit_of_recordings, white, pushes):
    answer = df.identify(fit_of_recordings, white)
    true = np.array([p.mu_s for p in pushes])
    for way, worst in (("mu_s_trace", 4.5), ("mu_s_slide", 4.5), ("mu_s_force", 4.5)):
        z = (answer.values(way) - true) / answer.standard_errors(way)
        assert np.nanmax(np.abs(z)) < worst, way
        assert np.isfinite(z).sum() >= 10
    error = answer.values("mu_s_trace") / true - 1
    assert np.abs(error).max() < 2e-3
    assert max(p.trace_reduced_chi2 for p in answer) < 1.2
    json.dumps(answer.as_dict(), allow_nan=True)


@pytest.mark.skipif(not PRACTICE.exists(), reason="the practice data are not here")
def test_the_clean_practice_set_within_three_standard_errors():
    folder = PRACTICE / "clean"
    truth = json.loads((folder / "truth.json").read_text())["rig"]
    fit = df.fit(df.load_setup(folder / "setup.toml"), df.load(folder / "pushes.tdms"))
    for label in FREE:
        assert fit.value(label) == pytest.approx(truth[label], abs=3 * fit.standard_error(label))
