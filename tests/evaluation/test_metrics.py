# SPDX-License-Identifier: Apache-2.0
"""The field's numbers: medians over the localized, shares over all."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray

from gscpe.errors import PoseError
from gscpe.evaluation import THRESHOLDS, evaluate, expected_error, normalized_error_squared
from gscpe.geometry import pose_difference, se3

Poses = dict[str, NDArray[np.float64]]


def moved(pose: NDArray[np.float64], metres: float, degrees: float) -> NDArray[np.float64]:
    """A pose whose camera centre and rotation differ by exactly this much."""
    turned = se3.exp([0, 0, 0, 0, np.radians(degrees), 0]) @ pose
    centre = se3.inverse(pose)[:3, 3] + [metres, 0, 0]
    turned[:3, 3] = -turned[:3, :3] @ centre
    return np.asarray(turned)


@pytest.fixture
def truth(rng: np.random.Generator) -> Poses:
    return {f"photo-{i}.png": random_pose(rng) for i in range(10)}


def test_the_error_that_a_covariance_promises(rng: np.random.Generator) -> None:
    """Root mean square of 4000 errors drawn from it, of cameras that are far from the origin."""
    root = np.diag([4e-3, 1e-3, 2e-3, 3e-3, 1e-3, 2e-3]) @ rng.normal(size=(6, 6))
    promised = expected_error(root @ root.T, 0.5)
    pose = random_pose(rng)
    errors = [pose_difference(se3.exp(root @ rng.normal(size=6)) @ pose, pose) for _ in range(4000)]
    distance = 0.5 * np.sqrt(np.mean([error.distance**2 for error in errors]))
    degrees = np.sqrt(np.mean([error.degrees**2 for error in errors]))
    assert promised.distance == pytest.approx(distance, rel=0.05)
    assert promised.degrees == pytest.approx(degrees, rel=0.05)


def test_thresholds_of_the_field() -> None:
    assert THRESHOLDS == ((0.10, 5.0), (0.05, 5.0), (0.02, 2.0), (0.01, 1.0))


def test_perfect_estimates(truth: Poses) -> None:
    result = evaluate(truth, truth)
    assert (result.queries, result.localized, result.ignored) == (10, 10, 0)
    assert result.median_distance == 0.0
    assert result.median_degrees < 1e-6
    assert result.shares == (1.0, 1.0, 1.0, 1.0)


def test_medians_and_shares(truth: Poses) -> None:
    errors = [(0.2, 1.0), (0.09, 0.5), (0.04, 4.0), (0.04, 6.0), (0.015, 1.5), (0.005, 0.2)]
    errors += [(0.009, 0.9), (0.001, 0.1), (0.03, 1.9)]
    estimates = {
        name: moved(pose, *error)
        for (name, pose), error in zip(truth.items(), errors, strict=False)
    }
    result = evaluate(estimates, truth)
    assert (result.queries, result.localized) == (10, 9)
    assert result.median_distance == pytest.approx(0.03, abs=1e-9)
    assert result.median_degrees == pytest.approx(1.0, abs=1e-6)
    # Of ten: the photo without an estimate counts as a failure.
    assert result.shares == pytest.approx((0.7, 0.6, 0.4, 0.3))


def test_missing_photos_count_as_failures(truth: Poses) -> None:
    half = dict(list(truth.items())[:5])
    result = evaluate(half, truth)
    assert result.localized == 5
    assert result.median_distance == 0.0
    assert result.shares == (0.5, 0.5, 0.5, 0.5)


def test_no_estimates_at_all(truth: Poses) -> None:
    result = evaluate({}, truth)
    assert result.localized == 0
    assert math.isnan(result.median_distance)
    assert math.isnan(result.median_degrees)
    assert result.shares == (0.0, 0.0, 0.0, 0.0)


def test_estimates_without_truth_are_counted_and_ignored(truth: Poses) -> None:
    estimates = {**truth, "other-1.png": np.eye(4), "other-2.png": np.eye(4)}
    result = evaluate(estimates, truth)
    assert (result.queries, result.localized, result.ignored) == (10, 10, 2)
    assert result.shares == (1.0, 1.0, 1.0, 1.0)


def test_an_even_number_takes_the_mean_of_the_middle_two(truth: Poses) -> None:
    names = list(truth)[:2]
    estimates = {names[0]: moved(truth[names[0]], 0.01, 1.0), names[1]: truth[names[1]]}
    result = evaluate(estimates, {name: truth[name] for name in names})
    assert result.median_distance == pytest.approx(0.005, abs=1e-9)
    assert result.median_degrees == pytest.approx(0.5, abs=1e-6)


def test_nothing_to_compare(truth: Poses) -> None:
    with pytest.raises(PoseError, match="the truth list is empty"):
        evaluate(truth, {})
    with pytest.raises(PoseError, match=r"no estimate has a name.*'a\.png' against 'photo-0\.png'"):
        evaluate({"a.png": np.eye(4)}, truth)


def test_normalized_errors_average_the_number_of_parameters() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)) * 0.01
    covariance = root @ root.T
    truth = se3.exp([0.3, -0.2, 1.0, 0.4, 0.1, -0.3])
    errors = [
        normalized_error_squared(
            se3.inverse(se3.exp(root @ rng.normal(size=6))) @ truth, covariance, truth
        )
        for _ in range(400)
    ]
    assert 5.5 < np.mean(errors) < 6.5
