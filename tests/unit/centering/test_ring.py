"""A measured ring: exact geometry, honest errors, outliers and lobes, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from difffric.centering.ring import FORM, evaluate_surface, measure
from difffric.centering.ring_csv import load_ring, write_ring
from difffric.errors import InputError
from tests.reference import rings

R, NOISE = 0.05, 0.3e-6
EXAMPLES = Path(__file__).parents[3] / "examples"


def centre_of(random, least=5e-6, most=5e-3):
    offset, phi = np.exp(random.uniform(np.log(least), np.log(most))), random.uniform(-np.pi, np.pi)
    return offset * np.array([np.cos(phi), np.sin(phi)])


@settings(max_examples=40, deadline=None)
@given(
    offset=st.floats(1e-9, 0.045),
    phi=st.floats(-3.1, 3.1),
    start=st.floats(-10, 10),
    arc=st.floats(1.0, 6.28),
    seed=st.integers(0, 1000),
)
def test_exact_readings_of_a_circle_give_its_centre_back(offset, phi, start, arc, seed):
    random = np.random.default_rng(seed)
    centre = offset * np.array([np.cos(phi), np.sin(phi)])
    angle, radius, _ = rings.readings(random, centre, R, n=50, start=start, arc=arc, noise=0.0)
    shuffled = random.permutation(50)
    ring = measure(angle[shuffled] + 2 * np.pi * random.integers(-3, 4, 50), radius[shuffled],
                   lobes=1)  # fmt: skip
    assert np.hypot(ring.x - centre[0], ring.y - centre[1]) < 1e-10
    assert abs(ring.radius - R) < 1e-10
    assert np.cos(ring.direction - phi) > 1 - 1e-9 or offset < 1e-6


def test_exact_readings_of_a_lobed_ring_give_its_lobes_back():
    lobes = {2: (3e-6, -1e-6), 5: (0.5e-6, 2e-6)}
    centre = np.array([2e-3, -1e-3])
    angle, radius, _ = rings.readings(np.random.default_rng(0), centre, R, lobes=lobes, noise=0.0)
    ring = measure(angle, radius, lobes=6)
    # The surface near the ray, instead of on it: lobes times their slope over R, 1e-10 m.
    assert np.hypot(ring.x - centre[0], ring.y - centre[1]) < 1e-9
    for n in range(2, 7):
        assert ring.lobes[n - 2] == pytest.approx(lobes.get(n, (0, 0)), abs=1e-9)
    assert evaluate_surface(ring, angle) == pytest.approx(radius, abs=1e-9)


def test_at_the_direction_the_surface_is_farthest():
    """Which is what tells the direction of the push."""
    angle, radius, _ = rings.readings(np.random.default_rng(1), (-1e-3, 2e-3), R, noise=0.0)
    ring = measure(angle, radius)
    assert np.cos(angle[np.argmax(radius)] - ring.direction) > np.cos(np.pi / 180)


@pytest.mark.parametrize("arc", [60, 120, 200, 360])
@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_normalised_errors_have_unit_variance_round_rings(arc, outliers):
    """Noise estimated; the offset's two components, made independent."""
    random, z = np.random.default_rng(arc), []
    for _ in range(250):
        centre = centre_of(random)
        angle, radius, _ = rings.readings(
            random, centre, R, n=180, start=random.uniform(0, 6), arc=np.radians(arc),
            outliers=outliers, noise=NOISE,
        )  # fmt: skip
        ring = measure(angle, radius, lobes=1)
        whiten = np.linalg.inv(np.linalg.cholesky(ring.covariance))
        z.append(whiten @ (np.array([ring.x, ring.y]) - centre))
    square = np.square(z).sum(axis=1)
    # chi-square of 2 x 250: mean 2, its standard error 2 / sqrt(250); four of them.
    assert square.mean() == pytest.approx(2, abs=4 * 2 / np.sqrt(250))
    assert np.abs(z).max() < 5


@pytest.mark.parametrize("arc", [60, 120, 200, 360])
def test_lobes_that_may_be_there_are_in_the_errors(arc):
    """Lobes of orders up to 8 of the size stated beforehand. On a short arc, where the readings
    leave their size open, the errors may be too wide, but not too narrow."""
    random, square = np.random.default_rng(arc + 1), []
    for _ in range(150):
        centre = centre_of(random)
        lobes = {n: random.normal(0, FORM, 2) for n in range(2, random.integers(3, 9))}
        angle, radius, _ = rings.readings(
            random, centre, R, start=random.uniform(0, 6), arc=np.radians(arc), lobes=lobes,
            outliers=0.05, noise=NOISE,
        )  # fmt: skip
        ring = measure(angle, radius)
        off = np.array([ring.x, ring.y]) - centre
        square.append(off @ np.linalg.solve(ring.covariance, off))
    assert np.mean(square) < 2 + 4 * 2 / np.sqrt(150)
    if arc == 360:
        assert np.mean(square) > 2 - 4 * 2 / np.sqrt(150)


@pytest.mark.parametrize("arc", [90, 360])
def test_without_outliers_the_cramer_rao_bound_is_attained(arc):
    """The information of the exact distances, by differences of the independent generator."""
    random = np.random.default_rng(5)
    start, centre, n, h = 0.3, np.array([1e-3, -2e-3]), 360, 1e-6
    angle = start + np.radians(arc) * np.arange(n) / n
    columns = [
        (rings.distance(angle, centre + s, R) - rings.distance(angle, centre - s, R)) / (2 * h)
        for s in (np.array([h, 0]), np.array([0, h]))
    ]
    columns.append((rings.distance(angle, centre, R + h) - rings.distance(angle, centre, R - h))
                   / (2 * h))  # fmt: skip
    by = np.stack(columns, axis=1)
    bound = (NOISE**2 * np.linalg.inv(by.T @ by))[:2, :2]
    exact, found = rings.distance(angle, centre, R), []
    for _ in range(400):
        ring = measure(angle, exact + NOISE * random.standard_normal(n), noise=NOISE, lobes=1)
        found.append([ring.x, ring.y])
        if not len(ring.outliers):
            assert ring.covariance == pytest.approx(bound, rel=1e-4)
    whitened = (np.array(found) - centre) @ np.linalg.inv(np.linalg.cholesky(bound)).T
    assert np.square(whitened).mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / 800))


def test_a_short_arc_says_that_it_is_short():
    random = np.random.default_rng(2)
    angle, radius, _ = rings.readings(random, (1e-4, 0), R, arc=np.radians(70))
    either, free = measure(angle, radius), measure(angle, radius, lobes=2)
    round_ring = measure(angle, radius, form=0)
    assert any("too short" in note for note in either.notes)
    assert either.offset_se > 3 * round_ring.offset_se < free.offset_se
    assert not measure(*rings.readings(random, (1e-4, 0), R)[:2]).notes


def test_outliers_are_listed_and_missing_samples_counted():
    random = np.random.default_rng(3)
    angle, radius, _ = rings.readings(random, (3e-4, 1e-4), R)
    bad = [7, 100, 250]
    radius[bad] += [20e-6, -5e-6, 1e-3]
    radius[[0, 50]] = np.nan
    ring = measure(angle, radius)
    assert set(bad) <= set(ring.outliers.tolist()) and len(ring.outliers) <= 5
    assert ring.missing == 2 and np.isnan(ring.residuals[[0, 50]]).all()


def test_repeated_angles_count():
    random = np.random.default_rng(4)
    angle = np.repeat(np.linspace(0, 6, 40), 9)
    radius = rings.distance(angle, (1e-4, 2e-4), R) + NOISE * random.standard_normal(360)
    ring = measure(angle, radius, lobes=1)
    assert abs(ring.x - 1e-4) < 5 * ring.covariance[0, 0] ** 0.5
    assert ring.reduced_chi2 is None
    known = measure(angle, radius, lobes=1, noise=NOISE).reduced_chi2
    assert known == pytest.approx((ring.noise / NOISE) ** 2, rel=0.05)


def test_the_file_round_trips(tmp_path):
    random = np.random.default_rng(6)
    angle, radius, _ = rings.readings(random, (1e-4, 0), R, n=30)
    radius[3] = np.nan
    write_ring(tmp_path / "ring.csv", angle, radius)
    back = load_ring(tmp_path / "ring.csv")
    for a, b in zip(back, (angle, radius), strict=True):
        assert a == pytest.approx(b, rel=1e-14, nan_ok=True)


def test_deviations_count_from_the_nominal_radius(tmp_path):
    angle, radius, _ = rings.readings(np.random.default_rng(7), (1e-3, 0), R, noise=0.0)
    columns = np.degrees(angle).tolist(), (1e6 * (radius - R)).tolist()
    rows = [f"{a!r},{x!r}" for a, x in zip(*columns, strict=True)]
    path = tmp_path / "ring.csv"
    path.write_text("\n".join(["angle_deg,reading_um", *rows]))
    ring = measure(*load_ring(path, R))
    assert ring.x == pytest.approx(1e-3, abs=1e-10)
    # A radius 1 % off changes the offset by less than e^2 / R of that.
    assert measure(*load_ring(path, 1.01 * R)).x == pytest.approx(1e-3, abs=1e-6)
    with pytest.raises(InputError, match="--radius-mm"):
        load_ring(path)


def test_the_example_s_truth_comes_out():
    truth = json.loads((EXAMPLES / "truth.json").read_text())["ring"]
    ring = measure(*load_ring(EXAMPLES / "ring.csv"))
    assert abs(1e6 * ring.offset - truth["offset_um"]) < 4e6 * ring.offset_se
    off = np.degrees(ring.direction) - truth["direction_deg"]
    assert abs(off) < 4 * np.degrees(ring.direction_se)
    assert len(ring.outliers) >= 9 and ring.missing == 4


RADII = [0.05] * 8


@pytest.mark.parametrize(
    ("angle", "radius", "options", "said"),
    [
        ([0, 1, 2], [0.05] * 3, {}, "3 usable readings; expected at least 4"),
        ([0, 1, 2, 3, 4], [0.05, 0.05, 0.05, np.nan, np.nan], {}, "3 usable readings"),
        ([1.0] * 8, RADII, {}, "1 different angles; expected at least 4"),
        ([0, 2 * np.pi, 1, 2, 1, 2, 0, 1], RADII, {}, "3 different angles"),
        ([0, 1, 2, 3], [0.05, 0.05, -0.05, 0.05], {}, "expected radii > 0, got -0.05 m"),
        (range(8), RADII, {"lobes": 4}, "expected at least 10 for lobes"),
        (range(8), RADII, {"lobes": 0}, "lobes: expected an order from 1"),
        (range(8), RADII, {"noise": -1.0}, "noise: expected a number > 0"),
        (range(7), RADII, {}, "as many angles as radii"),
    ],
)  # fmt: skip
def test_what_cannot_be_measured_is_one_clear_line(angle, radius, options, said):
    with pytest.raises(InputError, match=said) as error:
        measure(angle, radius, **options)
    assert "\n" not in str(error.value)


def test_an_offset_not_smaller_than_the_radius_is_refused():
    """The axis outside the ring: its distances belong to no circle about the axis."""
    angle = np.linspace(-0.5, 0.5, 40)
    far = np.cos(angle) * 0.1 + np.sqrt(0.05**2 - (0.1 * np.sin(angle)) ** 2)
    with pytest.raises(InputError, match="less than the radius"):
        measure(angle, far, lobes=1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "got nothing"),
        ("angle_deg\n1\n", "either radius_mm or reading_um, got angle_deg"),
        ("angle,radius_mm\n1,50\n", "expected the columns angle_deg"),
        ("angle_deg,radius_mm\n1,50\nx,50\n", "line 3: angle_deg: expected a number, got 'x'"),
        ("angle_deg,radius_mm\n1,-50\n", "line 2: radius_mm: expected a number > 0, got -50"),
        ("angle_deg,radius_mm\n1,50,3\n", "line 2: 3 cells, expected 2"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_read_says_where(tmp_path, text, said):
    path = tmp_path / "ring.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        load_ring(path)
