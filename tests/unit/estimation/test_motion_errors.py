"""Residuals are made blind, in proportion, to what the error of a recorded motion does."""

from __future__ import annotations

import numpy as np
import pytest

from difffric.estimation.following.motion_errors import DIRECTIONS, blind

M = 60


def whitener(D):
    W = blind(D)
    return np.eye(len(D)) - W @ W.T


@pytest.mark.parametrize("directions", [1, 3, DIRECTIONS])
def test_noise_with_an_error_in_some_directions_is_white_again(directions):
    D = np.random.default_rng(directions).standard_normal((M, directions)) * 0.7
    L = whitener(D)
    np.testing.assert_allclose(L @ (np.eye(M) + D @ D.T) @ L.T, np.eye(M), atol=1e-12)
    np.testing.assert_allclose(L, L.T, atol=1e-15)


def test_without_an_error_nothing_is_changed():
    np.testing.assert_array_equal(whitener(np.zeros((M, 5))), np.eye(M))


def test_of_a_large_error_nothing_is_left_and_all_else_is_kept():
    D = np.random.default_rng(0).standard_normal((M, 4))
    L, other = whitener(1e9 * D), np.random.default_rng(1).standard_normal(M)
    other -= D @ np.linalg.lstsq(D, other)[0]
    np.testing.assert_allclose(L @ D, 0, atol=1e-7)
    np.testing.assert_allclose(L @ other, other, atol=1e-12)


def test_one_direction_is_the_whitening_by_one_vector():
    d = np.random.default_rng(2).standard_normal(M)
    w = d * np.sqrt((1 - 1 / np.sqrt(1 + d @ d)) / (d @ d))
    np.testing.assert_allclose(whitener(d[:, None]), np.eye(M) - np.outer(w, w), atol=1e-14)


def test_of_more_directions_than_are_kept_those_count_that_do_most():
    """What is left out does as little as the directions that follow."""
    rng = np.random.default_rng(3)
    U = np.linalg.qr(rng.standard_normal((M, DIRECTIONS + 8)))[0]
    size = np.geomspace(10, 0.01, DIRECTIONS + 8)
    L = whitener(rng.permutation((U * size).T).T)
    left = L @ (np.eye(M) + (U * size**2) @ U.T) @ L.T
    assert np.linalg.norm(left - np.eye(M), 2) < 1.05 * size[DIRECTIONS] ** 2
