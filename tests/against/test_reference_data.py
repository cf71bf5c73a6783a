"""The generator of made data: its traces, noise and files, and the examples made with it."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from nptdms import TdmsFile
from scipy.integrate import solve_ivp
from scipy.stats import chi2, kstest

from difffric.measurements.pushes import Pushes
from difffric.rig.setup_toml import load_setup
from tests.reference import data, exact, files, make_examples, ode, traces
from tests.reference.data import MM_MIN, NO_NOISE, Rig

ROOT = Path(__file__).parents[2]
CASES = json.loads((ROOT / "tests" / "reference" / "cases.json").read_text())["cases"]
PRACTICE = Path(os.environ.get("DIFFFRIC_PRACTICE", ROOT.parent / "shared" / "data" / "practice"))
PLAIN = Rig(m=18.9, mu_s=0.14, ratio=0.75, k_v=6.0, k=8.2e5, b=1600.0, scatter=0.02, stroke=1e-3)


@pytest.fixture
def rng():
    return np.random.default_rng(20250301)


@pytest.fixture(scope="module")
def study():
    """200 random rigs and the pushes of each."""
    rng = np.random.default_rng(1)
    rigs = [data.random_rig(rng) for _ in range(200)]
    return rigs, [data.make_pushes(rig, rng) for rig in rigs]


def assert_same_course(course, laws, rng, n=12):
    """The course in floats and numpy is that of 60 digits, to 1e-9 of its largest values."""
    truth = exact.push(*laws, horizon=data.LONGEST)
    assert course.answer.modes == truth.modes
    np.testing.assert_allclose(course.peak_force, float(truth.peak_force), rtol=1e-9)
    if truth.sliding_distance is None:
        assert course.sliding_distance is None
    else:
        np.testing.assert_allclose(
            course.sliding_distance, float(truth.sliding_distance), rtol=1e-9
        )
    until = min(1.1 * float(truth.segments[-1].start) + 1e-3, data.LONGEST)
    times = np.concatenate([[-1e-3], rng.uniform(0, until, n)])
    force, x, _ = course(times)
    their_force = np.array([float(truth.force(exact.MP.mpf(t))) for t in times])
    their_x = np.array([float(truth.position(exact.MP.mpf(t))) for t in times])
    np.testing.assert_allclose(force, their_force, rtol=0, atol=1e-9 * course.peak_force)
    np.testing.assert_allclose(x, their_x, rtol=0, atol=1e-9 * max(np.abs(their_x).max(), 1e-9))


def test_courses_of_random_rigs_are_those_of_60_digits(study, rng):
    for pushes in study[1][:60]:
        for push in pushes[:4]:
            rig = push.rig
            laws = (rig.m, push.mu_s, rig.ratio, rig.k_v, rig.k, rig.b, push.velocity, push.stroke)
            assert_same_course(push.course, laws, rng)


def test_courses_of_every_kind_of_damping_are_those_of_60_digits(rng):
    """Random cases, then the critically damped and those with an overdamped rebound."""
    names = ("mass_kg", "mu_s", "mu_k_over_mu_s", "k_v_N_s_per_m", "k_N_per_m", "b_N_s_per_m")
    names = (*names, "velocity_m_per_s", "stroke_m")
    chosen = [c for c in CASES if c["margin"] is None or c["margin"] > 1e-6]

    def excess(c):
        return (c["b_N_s_per_m"] + c["k_v_N_s_per_m"]) ** 2 - 4 * c["k_N_per_m"] * c["mass_kg"]

    critical = [c for c in chosen if excess(c) == 0]
    creeping = [c for c in chosen if c["k_v_N_s_per_m"] ** 2 > 4 * c["k_N_per_m"] * c["mass_kg"]]
    assert critical and creeping
    for case in chosen[::20] + critical[:6] + creeping[:6]:
        laws = tuple(case[name] for name in names)
        assert_same_course(traces.follow(*laws, horizon=data.LONGEST), laws, rng, n=6)


def test_traces_agree_with_an_integrator(study):
    """A second opinion that shares no solution with the first; at 1e-6 from a jump, either side
    may be meant."""
    times = np.linspace(1e-5, 0.06, 300)
    for pushes in study[1][:6]:
        push, rig = pushes[0], pushes[0].rig
        laws = (rig.m, push.mu_s, rig.ratio, rig.k_v, rig.k, rig.b, push.velocity, push.stroke)
        answer = ode.push(*laws, times=times)
        force, x, _ = push.course(times)
        beside = np.abs(times[:, None] - push.course.jumps).min(axis=1) < 1e-6
        np.testing.assert_allclose(x, answer.position, rtol=0, atol=1e-7 * x.max())
        np.testing.assert_allclose(
            force[~beside], answer.force[~beside], rtol=0, atol=1e-6 * push.peak_force
        )


def test_the_force_peaks_at_F_p_and_jumps_only_where_it_is_said(study):
    for pushes in study[1][:20]:
        push, rig = pushes[0], pushes[0].rig
        dt = 1e-6
        times = dt * np.arange(-100, round(push.course.end / dt) + 100)
        force = push.course(times)[0]
        assert force.max() <= push.peak_force * (1 + 1e-12)
        np.testing.assert_allclose(force.max(), push.peak_force, rtol=1e-3)
        steepest = (rig.k * push.velocity + rig.b * push.peak_force / rig.m) * dt
        jumped = times[1:][np.abs(np.diff(force)) > 2 * steepest]
        assert all(np.abs(t - push.course.jumps).min() < 2 * dt for t in jumped)


@pytest.mark.parametrize("k_v", [0.0, 1e-9, 6.0, 30.0])
def test_a_free_slide_is_that_of_its_equation(k_v):
    m, mu_s, ratio, u = 18.9, 0.14, 0.75, 0.4
    F = ratio * mu_s * m * exact.GRAVITY

    def at_rest(t, s):
        return s[1]

    at_rest.terminal, at_rest.direction = True, -1
    found = solve_ivp(
        lambda t, s: [s[1], -(F + k_v * s[1]) / m],
        (0, 10),
        [0, u],
        events=at_rest,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
    )
    np.testing.assert_allclose(
        traces.slide(m, mu_s, ratio, k_v, u), found.y_events[0][0][0], rtol=1e-9
    )


def test_random_rigs_are_as_stated(study):
    rigs, pushes = study
    zeta = [rig.b / (2 * math.sqrt(rig.k * rig.m)) for rig in rigs]
    for values, low, high in [
        ([r.m for r in rigs], 5, 30),
        ([r.k for r in rigs], 2e5, 3e6),
        ([r.mu_s for r in rigs], 0.08, 0.25),
        ([r.k_v for r in rigs], 0, 30),
        ([r.scatter for r in rigs], 0, 0.05),
        (zeta, 0.1, 0.5),
    ]:
        assert low <= min(values) <= max(values) <= high
    assert kstest([math.log(r.k / 2e5) / math.log(15) for r in rigs], "uniform").pvalue > 1e-3
    every = [p for each in pushes for p in each]
    assert {p.course.regime for p in every} == {
        "released_by_rebound",
        "released_at_stop",
        "pushed_to_rest",
    }
    assert {p.course.answer.stuck_first for p in every} == {True, False}
    assert max(p.course.contacts for p in every) <= exact.MAX_CONTACTS
    assert all(math.isfinite(p.course.end) for p in every)


def test_the_same_seed_draws_the_same_and_another_does_not():
    def drawn(seed):
        rng = np.random.default_rng(seed)
        rig = data.random_rig(rng)
        return rig, data.record(data.make_pushes(rig, rng)[0], rng).force

    (rig, force), (again, same), (other, _) = drawn(1), drawn(1), drawn(2)
    assert rig == again and rig != other
    np.testing.assert_array_equal(force, same)


def test_log_mu_s_is_normal_with_the_scatter(rng):
    pushes = data.make_pushes(PLAIN, rng, 400)
    z = np.log([p.mu_s / PLAIN.mu_s for p in pushes]) / PLAIN.scatter
    assert kstest(z, "norm").pvalue > 1e-3
    assert sorted(p.velocity for p in data.make_pushes(PLAIN, rng)) == list(data.SPEEDS)


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_noise_is_stationary_with_its_deviation_and_correlation(rho, rng):
    """Across realisations each sample has deviation sigma, neighbours correlation rho."""
    n, sigma = 4000, 0.5
    e = np.array([data.coloured(40, sigma, rho, rng) for _ in range(n)])
    for i in (0, 1, 39):
        assert chi2.cdf((e[:, i] ** 2).sum() / sigma**2, n) == pytest.approx(0.5, abs=0.4999)
    found = np.corrcoef(e[:, 20], e[:, 21])[0, 1]
    assert abs(found - rho) < 4 * (1 - rho**2) / math.sqrt(n)


def test_readings_of_a_table_are_normal_about_the_truth(study, rng):
    z = []
    for pushes in study[1]:
        columns = data.measure(pushes, rng, force_se=0.5, distance_se=1e-6)
        d = np.array([p.sliding_distance for p in pushes])
        F_p = np.array([p.peak_force for p in pushes])
        z += [*((columns["peak_force"] - F_p) / columns["peak_force_se"])]
        of_d = (columns["sliding_distance"] - d) / columns["sliding_distance_se"]
        z += [*of_d[np.isfinite(of_d)]]
        np.testing.assert_array_equal(np.isnan(of_d), ~(d >= 5e-6))
    assert kstest(z, "norm").pvalue > 1e-3


def test_samples_lie_half_an_interval_from_t_0_from_quiet_to_rest(rng):
    for push in data.make_pushes(PLAIN, rng, 5):
        one = data.record(push, rng, noise=NO_NOISE)
        assert np.abs(one.time).min() == pytest.approx(one.dt / 2)
        assert one.time[0] == pytest.approx(-0.02 + one.dt / 2)
        assert 0 <= push.course.end + 0.03 - one.time[-1] < one.dt
        quiet = one.time < 0
        assert (one.force[quiet] == 0).all() and (one.force[one.time > push.course.end] == 0).all()
        assert np.ptp(one.position[quiet]) == 0
        moved = one.position[-1] - one.position[0]
        assert moved == pytest.approx(push.course(one.time[-1])[1], abs=1e-15)


def test_a_start_offset_moves_the_push_on_the_recorder_s_clock(rng):
    push = data.make_pushes(PLAIN, rng, 1)[0]
    one = data.record(push, rng, noise=NO_NOISE, jitter=30e-6, pusher=True)
    assert one.offset != 0 and one.pusher is not None
    force, x, y = push.course(one.time - one.offset)
    np.testing.assert_array_equal(one.force, force)
    np.testing.assert_allclose(one.pusher - one.position, y - x, atol=1e-15)


def test_recordings_are_written_in_the_contract_s_form(tmp_path, rng):
    pushes = data.make_pushes(PLAIN, rng, 3)
    recorded = [data.record(push, rng, pusher=True) for push in pushes]
    files.write_recordings(tmp_path / "a.tdms", recorded)
    file = TdmsFile.read(tmp_path / "a.tdms")
    assert [group.name for group in file.groups()] == ["push 0001", "push 0002", "push 0003"]
    for group, one in zip(file.groups(), recorded, strict=True):
        assert dict(group.properties) == {
            "velocity_mm_min": round(one.push.velocity / MM_MIN, 6),
            "mass_kg": 18.9,
            "stroke_mm": 1.0,
            "order": one.push.order,
            "condition": "A",
        }
        assert [c.name for c in group.channels()] == ["force", "position", "pusher"]
        assert dict(group["position"].properties) == {
            "unit_string": "um",
            "wf_increment": 1e-4,
            "wf_start_offset": -0.01995,
            "wf_samples": len(one.force),
        }
        np.testing.assert_array_equal(group["force"][:], one.force)
        np.testing.assert_allclose(group["position"][:] * 1e-6, one.position, atol=1e-12)
        steps = group["position"][:] / 0.02
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_volts_and_omitted_properties_are_written_as_asked(tmp_path, rng):
    one = data.record(data.make_pushes(PLAIN, rng, 1)[0], rng)
    files.write_recordings(
        tmp_path / "v.tdms", [one], position_unit="mm", sensitivity=11.2e-3, omit=["stroke_mm"]
    )
    group = TdmsFile.read(tmp_path / "v.tdms")["push 0001"]
    assert "stroke_mm" not in group.properties
    assert group["force"].properties["unit_string"] == "V"
    np.testing.assert_allclose(group["force"][:] / 11.2e-3, one.force, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(group["position"][:] * 1e-3, one.position, atol=1e-12)


def test_tables_hold_what_was_measured_in_their_units(tmp_path, rng):
    columns = data.measure(data.make_pushes(PLAIN, rng), rng)
    columns["sliding_distance"][3] = np.nan
    files.write_table(tmp_path / "a.csv", columns)
    table = pl.read_csv(tmp_path / "a.csv")
    for name, (column, unit) in files.COLUMNS.items():
        if name in columns and unit is not None:
            read = table[column].cast(pl.Float64).fill_null(np.nan).to_numpy() * unit
            np.testing.assert_allclose(read, columns[name], rtol=1e-11)
    assert table["sliding_distance_um"].null_count() == 1
    files.write_table(tmp_path / "b.csv", columns, standard_errors=False, omit=["mass_kg"])
    left = set(table.columns) - set(pl.read_csv(tmp_path / "b.csv").columns)
    assert left == {"peak_force_se_N", "sliding_distance_se_um", "mass_kg"}


def test_guesses_are_off_by_the_factors_at_most(tmp_path, rng):
    for _ in range(50):
        rig = data.random_rig(rng)
        guess = files.rough_setup(tmp_path / "setup.toml", rig, rng, {"k": 3, "b": 2, "mu_s": 1.5})
        for name, factor in [("k", 3), ("b", 2), ("mu_s", 1.5)]:
            off = abs(math.log(getattr(guess, name) / getattr(rig, name)))
            assert off <= math.log(factor) + 1e-12
        assert (guess.m, guess.ratio, guess.k_v) == (rig.m, rig.ratio, 5.0)


def practice_clean():
    folder = PRACTICE / "clean"
    if not folder.is_dir():
        pytest.skip(f"no practice data in {folder} (DIFFFRIC_PRACTICE names another place)")
    truth = json.loads((folder / "truth.json").read_text())
    file, rig = TdmsFile.read(folder / "pushes.tdms"), truth["rig"]
    for told, group in zip(truth["pushes"], file.groups(), strict=True):

        def follow(mu_s, told=told, group=group):
            return traces.follow(
                rig["mass_kg"],
                mu_s,
                rig["mu_k_over_mu_s"],
                rig["k_v_N_s_per_m"],
                rig["k_N_per_m"],
                rig["b_N_s_per_m"],
                told["velocity_mm_min"] * MM_MIN,
                group.properties["stroke_mm"] * 1e-3,
            )

        yield told, group, follow


def test_the_practice_set_has_our_F_p_and_d():
    """F_p to 1e-3 N and d to 5e-3 um, beside what the sixth digit of its mu_s leaves open."""
    for told, _, follow in practice_clean():
        low, course, high = (follow(told["mu_s"] + e) for e in (-5e-7, 0, 5e-7))
        open_d = abs(high.sliding_distance - low.sliding_distance) / 2
        F_p, d = told["peak_contact_force_N"], told["sliding_distance_um"] * 1e-6
        assert abs(course.peak_force - F_p) <= 1e-3
        assert abs(course.sliding_distance - d) <= 5e-9 + open_d
        assert course.contacts == told["contacts"]


def test_the_practice_recordings_less_our_traces_are_white_noise_of_its_deviation():
    """The times of the samples included: a shift by half an interval at t = 0 would be seen."""
    z = {"force": [], "position": []}
    for told, group, follow in practice_clean():
        course = follow(told["mu_s"])
        force, x, _ = course(group["force"].time_track())
        assert np.isclose(group["force"].time_track()[-1], course.end + 0.03, rtol=0, atol=1e-4)
        x = x + np.mean(group["position"][:] * 1e-6 - x)
        z["force"].append((group["force"][:] - force) / 0.5)
        z["position"].append((group["position"][:] * 1e-6 - x) / 0.3e-6)
    for name, each in z.items():
        every = np.concatenate(each)
        n = len(every)
        assert abs(every.std() - 1) < 4 / math.sqrt(2 * n), name
        assert np.abs(every).max() < 5.5, name
        for lag in (1, 2, 5):
            products = np.concatenate([e[lag:] * e[:-lag] for e in each])
            assert abs(products.mean()) < 4 / math.sqrt(n), (name, lag)
        # what a wrong phase would leave: too large residuals where the force is steep
        moving = np.concatenate([e[200:550] for e in each])
        assert abs(moving.std() - 1) < 4 / math.sqrt(2 * len(moving)), name


def test_the_examples_are_what_their_command_makes(tmp_path):
    make_examples.write(tmp_path)
    made = {path.name for path in tmp_path.iterdir()}
    assert made == {p.name for p in make_examples.EXAMPLES.iterdir() if p.is_file()}
    for name in made - {"pushes.tdms"}:
        assert (tmp_path / name).read_bytes() == (make_examples.EXAMPLES / name).read_bytes(), name
    ours, theirs = (
        TdmsFile.read(folder / "pushes.tdms") for folder in (tmp_path, make_examples.EXAMPLES)
    )
    for mine, its in zip(ours.groups(), theirs.groups(), strict=True):
        assert (mine.name, dict(mine.properties)) == (its.name, dict(its.properties))
        for one, other in zip(mine.channels(), its.channels(), strict=True):
            assert dict(one.properties) == dict(other.properties)
            np.testing.assert_array_equal(one[:], other[:])
    assert (make_examples.EXAMPLES / "pushes.tdms").stat().st_size < 400_000


def test_the_examples_hold_their_truth():
    """Table and recordings are noise about truth.json, the same pushes in the same order."""
    truth = json.loads((make_examples.EXAMPLES / "truth.json").read_text())
    table = pl.read_csv(make_examples.EXAMPLES / "pushes.csv")
    told = {k: np.array([p[k] for p in truth["pushes"]]) for k in truth["pushes"][0]}
    assert table["condition"].to_list() == [p["condition"] for p in truth["pushes"]]
    np.testing.assert_array_equal(table["velocity_mm_min"], told["velocity_mm_min"])
    z = (table["peak_force_N"].to_numpy() - told["peak_contact_force_N"]) / table["peak_force_se_N"]
    assert chi2.sf((z.to_numpy() ** 2).sum(), len(z)) > 1e-3
    z = table["sliding_distance_um"].to_numpy() - told["sliding_distance_um"]
    assert chi2.sf(((z / table["sliding_distance_se_um"].to_numpy()) ** 2).sum(), len(z)) > 1e-3
    file = TdmsFile.read(make_examples.EXAMPLES / "pushes.tdms")
    for group, push in zip(file.groups(), truth["pushes"], strict=True):
        assert group.properties["velocity_mm_min"] == push["velocity_mm_min"]
        assert group.properties["condition"] == push["condition"]
        assert abs(group["force"][:].max() - push["peak_contact_force_N"]) < 5 * 0.5


def test_the_reference_shares_no_code_with_the_library():
    for path in (ROOT / "tests" / "reference").glob("*.py"):
        assert not re.search(r"^\s*(from|import)\s+difffric\b", path.read_text(), re.M), path.name


def test_the_library_takes_the_set_ups_and_the_columns(tmp_path, rng):
    guess = files.rough_setup(tmp_path / "setup.toml", PLAIN, rng)
    rig = load_setup(tmp_path / "setup.toml")
    assert (rig.mass, rig.pusher.stroke) == (PLAIN.m, PLAIN.stroke)
    np.testing.assert_allclose(rig.contact.k, guess.k, rtol=1e-3)
    assert load_setup(make_examples.EXAMPLES / "setup.toml").mass == make_examples.DRY.m
    pushes = data.make_pushes(PLAIN, rng)
    assert len(Pushes(**data.measure(pushes, rng))) == 14
    assert Pushes(**data.measure_slides(PLAIN, rng, 40).columns).free_slides
