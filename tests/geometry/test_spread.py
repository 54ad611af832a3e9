# SPDX-License-Identifier: Apache-2.0
"""Directions over the sphere, points far from each other, and indices evenly apart."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import random_pose
from hypothesis import given
from hypothesis import strategies as st

from gscpe.geometry.pose_error import camera_centre, camera_centres
from gscpe.geometry.spread import even_directions, evenly_spread, farthest_first, thinned


@pytest.mark.parametrize("count", [32, 96, 500])
def test_directions_are_spread_evenly(count: int) -> None:
    """Their mean and their second moments are those of the sphere, and none are neighbours."""
    directions = even_directions(count)
    assert directions.shape == (count, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    np.testing.assert_allclose(directions.mean(axis=0), 0.0, atol=1.0 / count)
    np.testing.assert_allclose(directions.T @ directions / count, np.eye(3) / 3, atol=1.0 / count)
    cosines = directions @ directions.T - 2.0 * np.eye(count)
    # Of discs as close together as they can be, centres would be 3.8 / sqrt(count) apart.
    assert np.arccos(cosines.max()) > 2.5 / np.sqrt(count)


def test_points_are_chosen_far_from_each_other() -> None:
    points = np.array([[0.0], [1.0], [10.0], [4.0], [6.5]])
    assert farthest_first(points, 4) == [0, 2, 3, 4]
    assert farthest_first(points, 9) == [0, 2, 3, 4, 1]


def test_weighted_points_come_first() -> None:
    points = np.array([[0.0], [1.0], [10.0], [4.0]])
    assert farthest_first(points, 3, np.array([1.0, 2.0, 0.1, 1.0])) == [1, 3, 0]


def test_no_place_is_chosen_twice() -> None:
    points = np.repeat(np.eye(3), 4, axis=0)
    assert len(farthest_first(points, 12)) == 3


def test_what_is_thinned_keeps_its_ends() -> None:
    assert thinned(range(9), 5) == [0, 2, 4, 6, 8]
    assert thinned(["a", "b"], 5) == ["a", "b"]


def test_centres_of_many_cameras(rng: np.random.Generator) -> None:
    poses = [random_pose(rng) for _ in range(5)]
    expected = [camera_centre(pose) for pose in poses]
    np.testing.assert_allclose(camera_centres(np.array(poses)), expected)
    assert camera_centres(np.zeros((0, 4, 4))).shape == (0, 3)


@given(count=st.integers(0, 300), most=st.integers(0, 320))
def test_evenly_spread(count: int, most: int) -> None:
    chosen = evenly_spread(count, most)
    assert len(set(chosen)) == len(chosen) == min(count, most)
    assert chosen == sorted(chosen)
    if len(chosen) > 1:
        assert (chosen[0], chosen[-1]) == (0, count - 1)
        steps = np.diff(chosen)
        assert steps.max() - steps.min() <= 1
