"""The exported predictor: within its bound of the exact inverse, silent where nothing tells mu_s,
and the same in C."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

import difffric as df
from difffric.commands.reports.export import describe_predictor, render_files, report_predictor
from difffric.errors import InputError, NumericalError
from difffric.identification.controller.domain import Line, find_determined
from difffric.identification.controller.fitting import (
    compute_readings,
    draw_points,
    fit_predictor,
    is_homogeneous,
)
from difffric.identification.controller.predictor import (
    BY_DISTANCE,
    BY_FORCE,
    DETERMINED,
    NEITHER,
    NOT_DETERMINED,
    NOT_MEASURED,
    OUTSIDE_BOX,
    SPEED_OUTSIDE,
    Box,
    Predictor,
)
from difffric.output_folder import to_json_types
from difffric.rig import parameters
from difffric.units import from_mm_min
from tests.compiler import needs_compiler

RIG = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8.2e5, b=1600.0, k_v=6.0)
BOX = Box(from_mm_min(500.0), from_mm_min(5000.0), 0.05, 0.30)
STROKE_BOX = Box(from_mm_min(1200.0), from_mm_min(2500.0), 0.08, 0.25)


def one(v, mu_s, rig=RIG):
    """(F_p, d) of one push."""
    seen = compute_readings(rig, [v], [mu_s])
    return [float(seen[name][0][0]) for name in ("force", "distance")]


@pytest.fixture(scope="module")
def exported():
    return fit_predictor(RIG, BOX, points=100_000)


@pytest.fixture(scope="module")
def with_stroke():
    rig = parameters.with_stroke(RIG, 1.2e-3)
    return rig, fit_predictor(rig, STROKE_BOX, points=100_000)


@pytest.mark.parametrize("scale", [0.1, 0.7, 3.0])
def test_without_a_stroke_pushes_are_homogeneous(scale):
    """F_p(s v, s mu_s) = s F_p(v, mu_s), and so d: why one curve serves every speed."""
    v, mu_s = draw_points(np.random.default_rng(0), BOX, 500)
    one, other = compute_readings(RIG, v, mu_s), compute_readings(RIG, scale * v, scale * mu_s)
    assert is_homogeneous(RIG)
    for name in ("force", "distance"):
        assert other[name][0] == pytest.approx(scale * one[name][0], rel=1e-11, nan_ok=True)


def test_a_stroke_or_an_effect_breaks_it():
    assert not is_homogeneous(parameters.with_stroke(RIG, 1e-3))
    assert not is_homogeneous(df.rig.extended(RIG, {"stribeck": {"v_s_m_per_s": 0.02}}))


def test_the_bound_holds_and_is_close(exported):
    """At points of its own, dense along one speed and at random over the box."""
    random = np.random.default_rng(7)
    v, mu_s = draw_points(random, BOX, 200_000)
    line = np.geomspace(BOX.least_mu_s, BOX.most_mu_s, 100_000)
    v, mu_s = np.append(v, np.full(100_000, BOX.slowest)), np.append(mu_s, line)
    seen = compute_readings(RIG, v, mu_s)
    found = exported.predictor.predict(v, seen["force"][0], seen["distance"][0])
    for name, value in (("force", found.mu_s_force), ("distance", found.mu_s_distance)):
        worst = np.nanmax(np.abs(value / mu_s - 1))
        assert exported.bound[name] / 3 < worst <= exported.bound[name] <= 0.005
    # Wherever one of them determines mu_s there is an answer.
    assert (found.status != NEITHER).all()


def test_what_the_model_determines_is_answered(exported):
    """And d without a release is not: what is missing of the box is where there is no d."""
    assert exported.determined["force"] == pytest.approx(1.0, abs=1e-9)
    assert all(share == 0 for share in exported.missed.values())
    v, mu_s = draw_points(np.random.default_rng(8), BOX, 50_000)
    d, elasticity = compute_readings(RIG, v, mu_s)["distance"]
    found = exported.predictor.predict(v, sliding_distance=d)
    assert (found.distance[np.isnan(d)] == NOT_MEASURED).all()
    far = np.isfinite(d) & (np.abs(elasticity) < 30)  # not on the edge of release itself
    assert (found.distance[far] == DETERMINED).all()


def test_it_agrees_with_the_exact_inversion(exported):
    v, mu_s = draw_points(np.random.default_rng(9), BOX, 20)
    seen = compute_readings(RIG, v, mu_s)
    found = exported.predictor.predict(v, seen["force"][0], seen["distance"][0])
    for target, quantity, mine in (
        (seen["force"][0], "peak_force", found.mu_s_force),
        (seen["distance"][0], "sliding_distance", found.mu_s_distance),
    ):
        for exact, value in zip(
            df.identification.invert(RIG, v, target, quantity), mine, strict=True
        ):
            if np.isfinite(value):
                assert value == pytest.approx(exact.value, rel=0.005)


def test_the_variance_is_that_of_the_readings(exported):
    """Against differences of mu_s in the reading, and inverse-variance weights."""
    p = exported.predictor
    v, (F, d) = 0.05, one(0.05, 0.15)
    found = p.predict(v, F, d, 0.5, 0.3e-6)
    h = 1e-6
    slope = (p.predict(v, F * (1 + h)).mu_s - p.predict(v, F * (1 - h)).mu_s) / (2 * h * F)
    assert found.variance_force == pytest.approx((0.5 * slope) ** 2, rel=1e-6)
    steep = (p.predict(v, np.nan, d * (1 + h)).mu_s - p.predict(v, np.nan, d * (1 - h)).mu_s) / (
        2 * h * d
    )
    assert found.variance_distance == pytest.approx((0.3e-6 * steep) ** 2, rel=1e-6)
    w = 1 / found.variance_force, 1 / found.variance_distance
    mean = (w[0] * found.mu_s_force + w[1] * found.mu_s_distance) / sum(w)
    assert found.mu_s == pytest.approx(mean, rel=1e-14)
    assert found.variance == pytest.approx(1 / sum(w), rel=1e-14)
    exact = np.abs(
        df.sensitivity(parameters.with_values(RIG, {"mu_s": 0.15}), v).peak_force["mu_s"]
    )
    assert 1 / slope == pytest.approx(exact, rel=0.1)


def test_the_status_says_which_reading_it_is_from(exported):
    p, v = exported.predictor, 0.05
    F, d = one(v, 0.15)
    assert p.predict(v, F, d, 0.5, 3e-7).status == BY_FORCE + BY_DISTANCE
    assert p.predict(v, F, d, 0.5).status == BY_FORCE  # d has no standard error
    assert p.predict(v, F, d, np.nan, 3e-7).status == BY_DISTANCE
    assert p.predict(v, F).status == BY_FORCE and np.isnan(p.predict(v, F).variance)
    assert p.predict(v, np.nan, d).force == NOT_MEASURED
    both = p.predict(v, F, d)
    assert both.mu_s == pytest.approx((both.mu_s_force + both.mu_s_distance) / 2)
    nothing = p.predict(v)
    assert nothing.status == NEITHER and np.isnan(nothing.mu_s)
    assert p.predict(0.1, F).force == SPEED_OUTSIDE == p.predict(np.nan, F).force
    assert p.predict(v, 3 * F).force in (NOT_DETERMINED, OUTSIDE_BOX)
    assert p.predict(v, F, -1.0).distance == NOT_DETERMINED
    assert p.predict(v, one(v, 0.32)[0]).force == OUTSIDE_BOX


def test_a_force_that_is_the_damper_s_step_determines_nothing():
    """F_p = b v at touch, whatever mu_s: the predictor says so, and d alone answers."""
    rig = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8.0e5, b=9000.0, k_v=0.0)
    F, elasticity = (float(x[0]) for x in compute_readings(rig, [0.08], [0.05])["force"])
    assert pytest.approx(9000 * 0.08) == F and elasticity == 0
    box = Box(from_mm_min(3000.0), from_mm_min(5000.0), 0.05, 0.30)
    found = fit_predictor(rig, box, points=20_000)
    assert found.predictor.predict(0.08, F).force == NOT_DETERMINED
    assert found.answered["force"] == pytest.approx(found.determined["force"], abs=0.02)


def test_with_a_stroke_it_is_silent_where_a_distance_means_several_mu_s(with_stroke):
    rig, found = with_stroke
    assert max(found.worst.values()) <= 0.005 and found.bound["force"] is None
    v = from_mm_min(1300.0)
    mu_s = np.linspace(STROKE_BOX.least_mu_s, STROKE_BOX.most_mu_s, 4000)
    d = compute_readings(rig, v, mu_s)["distance"][0]
    answered = found.predictor.predict(v, sliding_distance=d).distance == DETERMINED
    low, high = np.minimum(d[1:], d[:-1]), np.maximum(d[1:], d[:-1])
    for i in np.flatnonzero(answered)[::50]:
        assert ((low < d[i]) & (d[i] < high)).sum() <= 1
    assert found.answered["either"] > 0.999


def test_determined_is_monotone_steep_and_unique():
    y = np.linspace(1.0, 3.0, 2001)
    middle = 0.5 * (y[1:] + y[:-1])

    def where(q, slope):
        return middle[find_determined(q, slope * y / q, y, 0.01)]

    assert len(where(y**2, 2 * y)) == 2000
    assert not len(where(np.full_like(y, 3.0), np.zeros_like(y)))
    assert not len(where(3 + 1e-3 * y, np.full_like(y, 1e-3)))
    fold = where((y - 1.5) ** 2 + 1, 2 * (y - 1.5))  # all below 2 has a twin, and is flat at 1.5
    assert fold.min() == pytest.approx(2.0, abs=0.01) and fold.max() > 2.99
    jump = where(y + (y > 2), np.ones_like(y))
    assert len(jump) == 1999
    gone = where(np.where(y < 2, y, np.nan), np.ones_like(y))
    assert gone.max() < 2.0


def test_a_line_is_the_inverse_of_its_grid():
    y = np.linspace(1.0, 2.0, 101)
    for q in (y**3, 1 / y):
        line = Line.of(y, q, np.ones(100, bool))
        assert (np.diff(line.X) >= 0).all()
        assert np.interp(q, line.X, line.y) == pytest.approx(y, rel=1e-12)
        assert line.measure_cover(q.min(), q.max()) == pytest.approx(1.0)


def test_json_brings_it_back(exported):
    stored = json.loads(json.dumps(to_json_types(exported.predictor.as_dict())))
    back = Predictor.from_dict(stored)
    v, mu_s = draw_points(np.random.default_rng(3), BOX, 100)
    F = compute_readings(RIG, v, mu_s)["force"][0]
    np.testing.assert_array_equal(back.predict(v, F), exported.predictor.predict(v, F))


def test_a_tighter_error_takes_more_cells(exported):
    tight = fit_predictor(RIG, BOX, max_error=2e-4, points=20_000)
    assert max(tight.bound.values()) <= 2e-4
    assert len(tight.predictor.force.lower) > len(exported.predictor.force.lower)


@pytest.mark.parametrize(
    ("box", "options", "said"),
    [
        (replace(BOX, fastest=BOX.slowest), {}, "the box is empty: speed"),
        (replace(BOX, least_mu_s=0.4), {}, "the box is empty: mu_s: .* got 0.4 to 0.3"),
        (BOX, {"max_error": 0.0}, "max_error: expected a share"),
        (BOX, {"least_elasticity": 2.0}, "least_elasticity"),
    ],
)
def test_bad_input_is_one_clear_line(box, options, said):
    with pytest.raises(InputError, match=said) as error:
        fit_predictor(RIG, box, **options)
    assert "\n" not in str(error.value)


def test_an_error_out_of_reach_says_what_was_reached():
    with pytest.raises(NumericalError, match=r"1e-09 of mu_s was asked for, .* was reached"):
        fit_predictor(RIG, replace(BOX, slowest=0.05), max_error=1e-9, points=1000)


def compiled(folder):
    """The self-test of a folder's predictor.c."""
    strict = "-std=c99 -Wall -Wextra -Wpedantic -Werror"
    compiler = next(c for c in ("cc", "gcc", "clang") if shutil.which(c))
    for flags in (f"{strict} -c -o p.o", f"{strict} -O2 -DDIFFFRIC_SELFTEST -o selftest"):
        done = subprocess.run(
            [compiler, *flags.split(), "predictor.c"], cwd=folder, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    return folder / "selftest"


@needs_compiler
@pytest.mark.parametrize("stroke", [False, True])
def test_the_c_function_gives_the_golden_vectors(stroke, exported, with_stroke, tmp_path):
    rig, found = with_stroke if stroke else (RIG, exported)
    for name, content in render_files(found, rig).items():
        (tmp_path / name).write_bytes(content)
    program = compiled(tmp_path)
    done = subprocess.run([program, "golden.csv"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0 and "400 of 400 rows right" in done.stdout
    assert float(done.stdout.split(";")[1].split("ns")[0]) < 1000  # asked: 1 us a call
    # It can fail: another number of mu_s in the first row is not given.
    lines = (tmp_path / "golden.csv").read_text().splitlines()
    cells = lines[1].split(",")
    cells[6] = repr(float(cells[6]) * (1 + 1e-9))
    (tmp_path / "golden.csv").write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]))
    assert subprocess.run([program, "golden.csv"], cwd=tmp_path).returncode == 1


def test_golden_vectors_hold_every_case(exported):
    table = render_files(exported, RIG)["golden.csv"].decode().splitlines()
    rows = np.array([[float(x) for x in line.split(",")] for line in table[1:]])
    names = table[0].split(",")
    assert set(rows[:, names.index("status")]) == {0, 1, 2, 3}
    assert {0, 1, 2, 3} <= set(rows[:, names.index("force")]) <= {0, 1, 2, 3, 4}
    assert {0, 1, 2, 3} <= set(rows[:, names.index("distance")])


def test_the_answer_and_the_report_say_what_is_proven(exported, with_stroke):
    answer = describe_predictor(exported, RIG)
    assert answer["proof"] == "bounded" and max(answer["bound"].values()) <= 0.005
    assert "which is proven" in report_predictor(exported, RIG).summary[0]
    rig, found = with_stroke
    assert describe_predictor(found, rig)["proof"] == "sampled"
    assert "several mu_s" in report_predictor(found, rig).summary[-1]
