# SPDX-License-Identifier: Apache-2.0
"""Similarities form a group, and are found again from what they moved."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import random_pose, random_rotation
from numpy.typing import NDArray

from gscpe.errors import PoseError
from gscpe.geometry import se3
from gscpe.geometry.pose_error import camera_centre
from gscpe.geometry.similarity_transform import Similarity, fit_similarity_of_poses


def random_similarity(rng: np.random.Generator) -> Similarity:
    return Similarity(
        float(np.exp(rng.uniform(-2, 2))), random_rotation(rng), rng.uniform(-5, 5, 3)
    )


def poses(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    return np.stack([random_pose(rng) for _ in range(count)])


@pytest.mark.parametrize("seed", range(3))
def test_group_axioms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    c_from_b, b_from_a, d_from_c = (random_similarity(rng) for _ in range(3))
    points = rng.normal(size=(7, 3))
    np.testing.assert_allclose(
        (c_from_b @ b_from_a).apply(points), c_from_b.apply(b_from_a.apply(points)), atol=1e-10
    )
    np.testing.assert_allclose(
        ((d_from_c @ c_from_b) @ b_from_a).matrix, (d_from_c @ (c_from_b @ b_from_a)).matrix
    )
    np.testing.assert_allclose((b_from_a.inverse() @ b_from_a).matrix, np.eye(4), atol=1e-12)
    np.testing.assert_allclose((b_from_a @ Similarity.identity()).matrix, b_from_a.matrix)
    np.testing.assert_allclose((c_from_b @ b_from_a).matrix, c_from_b.matrix @ b_from_a.matrix)
    np.testing.assert_allclose(Similarity.of_matrix(b_from_a.matrix).matrix, b_from_a.matrix)


def test_a_moved_camera_sees_moved_points_where_it_saw_them() -> None:
    rng = np.random.default_rng(3)
    b_from_a, points, cameras = random_similarity(rng), rng.normal(size=(5, 3)), poses(rng, 4)
    for cam_from_a, cam_from_b in zip(cameras, b_from_a.cam_from_b(cameras), strict=True):
        in_a = points @ cam_from_a[:3, :3].T + cam_from_a[:3, 3]
        in_b = b_from_a.apply(points) @ cam_from_b[:3, :3].T + cam_from_b[:3, 3]
        np.testing.assert_allclose(in_b, b_from_a.scale * in_a, atol=1e-9)
        np.testing.assert_allclose(
            camera_centre(cam_from_b), b_from_a.apply(camera_centre(cam_from_a)), atol=1e-9
        )
        np.testing.assert_allclose(cam_from_b, b_from_a.cam_from_b(cam_from_a))


@pytest.mark.parametrize("count", [2, 3, 8])
def test_poses_give_their_similarity_back(count: int) -> None:
    rng = np.random.default_rng(count)
    b_from_a, cameras = random_similarity(rng), poses(rng, count)
    fit = fit_similarity_of_poses(b_from_a.cam_from_b(cameras), cameras, lever=2.0)
    np.testing.assert_allclose(fit.b_from_a.matrix, b_from_a.matrix, atol=1e-8)
    assert fit.scale_sigma < 1e-6
    assert fit.rms_distance < 1e-8
    assert fit.rms_degrees < 1e-6


def test_wrong_poses_do_not_count_even_where_a_third_are_wrong() -> None:
    rng = np.random.default_rng(9)
    b_from_a, cameras = random_similarity(rng), poses(rng, 12)
    measured = b_from_a.cam_from_b(cameras)
    measured[::3] = poses(rng, 4)
    fit = fit_similarity_of_poses(measured, cameras, lever=2.0)
    np.testing.assert_allclose(fit.b_from_a.matrix, b_from_a.matrix, atol=1e-8)
    assert np.all(fit.weights[::3] == 0)
    assert np.all(fit.weights[1::3] > 0.9)


def test_the_scale_is_as_sure_as_it_says() -> None:
    rng = np.random.default_rng(10)
    cameras, errors, sigmas = poses(rng, 10), [], []
    for _ in range(60):
        noisy = np.stack([se3.exp(rng.normal(0, 0.003, 6)) @ pose for pose in cameras])
        fit = fit_similarity_of_poses(noisy, cameras, lever=2.0)
        errors.append(fit.b_from_a.scale - 1.0)
        sigmas.append(fit.scale_sigma)
    assert 0.7 < np.std(errors) / np.mean(sigmas) < 1.4


def test_cameras_that_stand_in_one_place_tell_no_scale() -> None:
    rng = np.random.default_rng(11)
    cameras = np.stack([se3.exp([0, 0, 0, *rng.normal(size=3)]) for _ in range(6)])
    moved = Similarity(1.0, random_rotation(rng), np.array([1.0, 2.0, 3.0]))
    noisy = [se3.exp(rng.normal(0, 1e-3, 6)) @ pose for pose in moved.cam_from_b(cameras)]
    fit = fit_similarity_of_poses(np.stack(noisy), cameras, lever=2.0)
    assert fit.scale_sigma == np.inf
    assert fit.b_from_a.scale == 1.0
    np.testing.assert_allclose(fit.b_from_a.matrix, moved.matrix, atol=3e-3)


@pytest.mark.parametrize(
    "matrix",
    [np.eye(3), np.diag([1, 1, -1, 1]), np.diag([1, 2, 3, 1]), np.full((4, 4), np.nan),
     np.vstack([np.eye(4)[:3], [0, 0, 1, 1]])],
)  # fmt: skip
def test_other_matrices_are_refused(matrix: NDArray[np.float64]) -> None:
    with pytest.raises(PoseError):
        Similarity.of_matrix(matrix)
