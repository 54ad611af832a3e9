# SPDX-License-Identifier: Apache-2.0
"""A turned splat looks the same from a turned camera, its harmonics included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import random_pose, random_rotation, random_scene, simple_camera
from numpy.typing import NDArray
from numpy_compositor import harmonics

from gscpe.render import Renderer
from gscpe.splats import GaussianScene
from gscpe.splats.gaussians import joined
from gscpe.splats.turned import Y_AND_Z_NEGATED, harmonics_turned, turned


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_colours_turn_with_the_axes(degree: int, rng: np.random.Generator) -> None:
    rotation = random_rotation(rng)
    band = slice(degree**2, (degree + 1) ** 2)
    coefficients = rng.normal(size=2 * degree + 1)
    after = harmonics_turned(rotation, degree) @ coefficients
    for direction in rng.normal(size=(20, 3)):
        unit = direction / np.linalg.norm(direction)
        before = harmonics(unit)[band] @ coefficients
        assert harmonics(rotation @ unit)[band] @ after == pytest.approx(before, abs=1e-12)


def test_negated_axes_only_change_signs() -> None:
    for degree in (1, 2, 3):
        matrix = harmonics_turned(Y_AND_Z_NEGATED, degree)
        np.testing.assert_allclose(np.abs(matrix), np.eye(2 * degree + 1), atol=1e-14)


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("kind", ["any", "y and z negated"])
def test_the_same_picture(kind: str, degree: int, backend: str, rng: np.random.Generator) -> None:
    pose = random_pose(rng)
    scene = random_scene(rng, 60, degree, cam_from_world=pose)
    rotation = random_rotation(rng) if kind == "any" else Y_AND_Z_NEGATED
    whole = np.eye(4)
    whole[:3, :3] = rotation

    def picture(scene: GaussianScene, pose: NDArray[np.float64]) -> NDArray[np.float32]:
        with Renderer(scene, backend) as renderer:
            return renderer.render(simple_camera(), pose).rgb

    expected = picture(scene, pose)
    again = picture(turned(scene, rotation), pose @ whole.T)
    # A Gaussian's alpha may fall to the other side of the renderer's threshold of 1/255.
    np.testing.assert_allclose(again, expected, atol=5e-3)
    assert np.abs(again - expected).mean() < 1e-5
    assert np.abs(picture(turned(scene, rotation), pose) - expected).mean() > 0.02


def test_there_and_back(rng: np.random.Generator) -> None:
    scene = random_scene(rng, 30, 3)
    back = turned(turned(scene, Y_AND_Z_NEGATED), Y_AND_Z_NEGATED)
    np.testing.assert_array_equal(back.means, scene.means)
    np.testing.assert_array_equal(back.sh, scene.sh)
    same = np.abs(np.sum(back.quaternions * scene.quaternions, axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-6)


def test_a_far_origin_turns_too(rng: np.random.Generator) -> None:
    scene = random_scene(rng, 30, 1)
    far = replace(scene, origin=np.array([5e5, 5.4e6, 30.0]))
    rotation = random_rotation(rng)
    after = turned(far, rotation)
    expected = (far.means + far.origin) @ rotation.T
    np.testing.assert_allclose(after.means + after.origin, expected, atol=1e-5)


def test_joined_scenes_keep_their_places(rng: np.random.Generator) -> None:
    a, b = random_scene(rng, 5, 1), random_scene(rng, 7, 0)
    a = replace(a, origin=np.array([5e5, 5.4e6, 30.0]))
    b = replace(b, origin=np.array([5e5, 5.4e6 + 8, 30.0]))
    both = joined([a, b])
    expected = np.concatenate([a.means + a.origin, b.means + b.origin])
    np.testing.assert_allclose(both.means + both.origin, expected, atol=1e-5)
