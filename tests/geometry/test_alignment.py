# SPDX-License-Identifier: Apache-2.0
"""Umeyama's alignment: exact on exact points, least squares on others, never a mirror image."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import random_pose

from gscpe.geometry import pose_difference, se3
from gscpe.geometry.alignment import umeyama
from gscpe.geometry.pose_error import camera_centre
from gscpe.geometry.similarity_transform import Similarity


@pytest.mark.parametrize("scale", [1.0, 0.02, 40.0])
@pytest.mark.parametrize("count", [3, 40])
def test_exact_points(scale: float, count: int, rng: np.random.Generator) -> None:
    moved = random_pose(rng)
    points = rng.normal(size=(count, 3))
    found = umeyama(points, scale * points @ moved[:3, :3].T + moved[:3, 3], scale != 1.0)
    np.testing.assert_allclose(found.rotation, moved[:3, :3], atol=1e-9)
    np.testing.assert_allclose(found.translation, moved[:3, 3], atol=1e-8)
    assert found.scale == pytest.approx(scale)


def test_noise_cannot_be_aligned_better(rng: np.random.Generator) -> None:
    """No small change of the seven numbers makes the squares less."""
    a = rng.normal(size=(30, 3))
    b = 2.0 * a @ random_pose(rng)[:3, :3].T + rng.normal(0, 0.2, (30, 3))
    found = umeyama(a, b)
    least = np.sum((found.apply(a) - b) ** 2)
    for step in (*np.eye(7), *-np.eye(7)):
        turn = se3.exp([0, 0, 0, *(1e-3 * step[:3])])[:3, :3]
        other = Similarity(
            found.scale * float(np.exp(1e-3 * step[6])),
            turn @ found.rotation,
            found.translation + 1e-3 * step[3:6],
        )
        assert np.sum((other.apply(a) - b) ** 2) > least


@pytest.mark.parametrize("with_scale", [False, True])
def test_mirrored_flat_and_single_points(with_scale: bool, rng: np.random.Generator) -> None:
    a = rng.normal(size=(9, 3))
    flat = a * [1, 1, 0]
    for b in (a * [1, 1, -1], flat, a[:, :1] * [1.0, 2.0, 3.0], np.zeros((9, 3))):
        for source in (a, flat, np.zeros((9, 3))):
            found = umeyama(source, b, with_scale)
            assert np.linalg.det(found.rotation) == pytest.approx(1.0)
            assert np.all(np.isfinite(found.translation))
    moved = random_pose(rng)
    found = umeyama(flat, flat @ moved[:3, :3].T + moved[:3, 3], with_scale)
    np.testing.assert_allclose(found.rotation, moved[:3, :3], atol=1e-9)
    found = umeyama(a[:1], a[1:2], with_scale)
    np.testing.assert_allclose(found.apply(a[0]), a[1])


def test_a_pose_moves_with_its_points(rng: np.random.Generator) -> None:
    """What the camera sees stays where it is in the picture."""
    motion = Similarity(3.0, random_pose(rng)[:3, :3], rng.normal(size=3))
    pose, points = random_pose(rng), rng.normal(size=(5, 3))
    moved = motion.cam_from_b(pose)
    before = points @ pose[:3, :3].T + pose[:3, 3]
    after = motion.apply(points) @ moved[:3, :3].T + moved[:3, 3]
    np.testing.assert_allclose(after, 3.0 * before, atol=1e-12)
    np.testing.assert_allclose(camera_centre(moved), motion.apply(camera_centre(pose)))
    same = Similarity.identity().cam_from_b(pose)
    assert pose_difference(same, pose).distance < 1e-12
