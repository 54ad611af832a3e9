# SPDX-License-Identifier: Apache-2.0
"""A splat under a similarity is rendered as before by cameras that move with it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import random_pose, random_rotation, random_scene, simple_camera

from gscpe.geometry.similarity_transform import Similarity
from gscpe.render import Renderer
from gscpe.scene import References
from gscpe.scene.moved import move_references, move_scene


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_renders_stay_what_they_were(degree: int) -> None:
    rng = np.random.default_rng(degree)
    camera, pose = simple_camera(), random_pose(rng)
    scene = random_scene(rng, 60, degree, cam_from_world=pose)
    moved = Similarity(0.24, random_rotation(rng), np.array([1.0, -2.0, 0.5]))
    references = move_references(References(("a",), pose[None], (camera,)), moved)
    with Renderer(scene) as renderer:
        before = renderer.render(camera, pose)
    with Renderer(move_scene(scene, moved)) as renderer:
        after = renderer.render(camera, references.cam_from_world[0])
    np.testing.assert_allclose(after.rgb, before.rgb, atol=2e-4)
    np.testing.assert_allclose(after.depth, 0.24 * before.depth, atol=1e-4)


def test_there_and_back_again() -> None:
    rng = np.random.default_rng(7)
    scene = random_scene(rng, 20, 3)
    moved = Similarity(7.0, random_rotation(rng), np.array([5e5, 5.4e6, 200.0]))
    back = move_scene(move_scene(scene, moved), moved.inverse())
    np.testing.assert_allclose(back.origin, 0, atol=1e-8)
    np.testing.assert_allclose(back.means, scene.means, atol=1e-5)
    np.testing.assert_allclose(back.scales, scene.scales, rtol=1e-5)
    np.testing.assert_allclose(back.sh, scene.sh, atol=1e-5)
