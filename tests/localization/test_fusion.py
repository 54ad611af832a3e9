# SPDX-License-Identifier: Apache-2.0
"""The mean of two poses."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import random_pose
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gscpe.errors import SettingsError
from gscpe.geometry import se3
from gscpe.localization.fusion import FusionSettings, fuse_matches_and_alignment, fuse_poses

seeds = st.integers(0, 2**32 - 1)


def random_covariance(rng: np.random.Generator) -> NDArray[np.float64]:
    """Metres and radians of very different size, correlated."""
    scale = 10.0 ** rng.uniform(-4, -2, 6)
    square = rng.normal(size=(6, 8)) * scale[:, None]
    return np.asarray(square @ square.T)


@given(seeds)
def test_it_minimizes_the_sum_of_both_squared_errors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = random_pose(rng)
    covariance_a, covariance_b = random_covariance(rng), random_covariance(rng)
    b = se3.exp(rng.multivariate_normal(np.zeros(6), covariance_b)) @ a
    fused, covariance = fuse_poses(a, covariance_a, b, covariance_b)

    def cost(cam_from_world: NDArray[np.float64]) -> float:
        errors = (se3.log(cam_from_world @ se3.inverse(each)) for each in (a, b))
        return sum(
            float(error @ np.linalg.solve(each, error))
            for error, each in zip(errors, (covariance_a, covariance_b), strict=True)
        )

    least = cost(fused)
    for _ in range(10):
        step = rng.multivariate_normal(np.zeros(6), covariance)
        assert cost(se3.exp(step) @ fused) >= least - 1e-6 * abs(least)
    information = np.linalg.inv(covariance_a) + np.linalg.inv(covariance_b)
    expected = np.linalg.inv(information)
    np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@given(seeds)
def test_an_estimate_that_knows_nothing_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_pose(rng), random_pose(rng)
    covariance = random_covariance(rng)
    b = se3.exp(rng.normal(scale=1e-2, size=6)) @ a
    for sure_first in (True, False):
        if sure_first:
            fused, _ = fuse_poses(a, covariance, b, 1e10 * covariance)
        else:
            fused, _ = fuse_poses(b, 1e10 * covariance, a, covariance)
        np.testing.assert_allclose(fused, a, atol=1e-6)


def test_the_order_of_the_two_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    a = random_pose(rng)
    b = se3.exp(rng.normal(scale=1e-4, size=6)) @ a
    covariances = random_covariance(rng), random_covariance(rng)
    one, one_covariance = fuse_poses(a, covariances[0], b, covariances[1])
    other, other_covariance = fuse_poses(b, covariances[1], a, covariances[0])
    np.testing.assert_allclose(one, other, atol=1e-7)
    np.testing.assert_allclose(one_covariance, other_covariance, rtol=1e-6, atol=1e-12)


def test_matches_count_less(rng: np.random.Generator) -> None:
    matched, aligned = random_pose(rng), random_pose(rng)
    aligned = se3.exp(rng.normal(scale=1e-2, size=6)) @ matched
    covariance = random_covariance(rng)
    pose, found = fuse_matches_and_alignment(
        matched, covariance, aligned, covariance, FusionSettings(matches_variance_factor=4.0)
    )
    whole = se3.log(aligned @ se3.inverse(matched))
    share = 4.0 / (1.0 + 4.0)
    np.testing.assert_allclose(se3.log(pose @ se3.inverse(matched)), share * whole, rtol=1e-6)
    # Weights 1/5 and 4/5 of estimates whose errors are correlated by a half.
    expected = (1.0 + 16.0 + 2.0 * 4.0 * 0.5) / 25.0
    np.testing.assert_allclose(found, expected * covariance, rtol=1e-6)


@given(seeds)
def test_estimates_that_share_all_errors_are_no_better_together(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, covariance = random_pose(rng), random_covariance(rng)
    for factor in (0.5, 1.0, 3.0):
        _, found = fuse_poses(a, covariance, a, covariance, factor, correlation=1.0)
        np.testing.assert_allclose(found, covariance, rtol=1e-5, atol=1e-5 * covariance.max())


def test_a_correlation_is_one() -> None:
    for wrong in (-0.1, 1.1, float("nan")):
        with pytest.raises(SettingsError, match="correlation"):
            FusionSettings(correlation=wrong)


def test_the_mean_of_two_that_share_errors_is_as_sure_as_it_says(rng: np.random.Generator) -> None:
    """Both see one photo and one map: half of the variance of each is the same. The normalized
    error squared of the mean averages 6 (as if they were independent, it would be 9)."""
    truth, covariance = random_pose(rng), random_covariance(rng)
    values = []
    for _ in range(300):
        shared, one, other = rng.multivariate_normal(np.zeros(6), 0.5 * covariance, 3)
        found, claimed = fuse_matches_and_alignment(
            se3.exp(shared + one) @ truth, covariance,
            se3.exp(shared + other) @ truth, covariance, FusionSettings(),
        )  # fmt: skip
        xi = se3.log(truth @ se3.inverse(found))
        values.append(xi @ np.linalg.solve(claimed, xi))
    assert 5.0 < np.mean(values) < 7.5


def test_matches_know_no_better_than_the_images() -> None:
    """What the images do not share is as little known to matches, however they scatter."""
    covariance = 1e-6 * np.eye(6)
    unshared = np.zeros((6, 6))
    unshared[1, 1] = 4.0
    matched, aligned = np.eye(4), se3.exp([2e-3, 1e-3, 0, 0, 0, 0])
    settings = FusionSettings()
    blind, found = fuse_matches_and_alignment(
        matched, covariance, aligned, covariance + unshared, settings, unshared
    )
    assert found[1, 1] > 1.0
    seeing, expected = fuse_matches_and_alignment(
        matched, covariance, aligned, covariance, settings
    )
    np.testing.assert_allclose(np.delete(found, 1, 0)[:, [0]], np.delete(expected, 1, 0)[:, [0]])
    assert blind[0, 3] == pytest.approx(seeing[0, 3])
    _, without = fuse_matches_and_alignment(
        matched, covariance, aligned, covariance + unshared, settings
    )
    assert without[1, 1] < 1e-5  # the scatter of the matches alone would promise this
