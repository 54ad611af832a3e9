# SPDX-License-Identifier: Apache-2.0
"""The baseline of tools/bench_refinement.py differentiates exactly and comes nearer."""

from __future__ import annotations

from typing import Any, Callable

import numpy as np
import pytest
from helpers import numeric_jacobian, random_rotation
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera, wall
from scipy.ndimage import gaussian_filter

from gscpe.geometry import pose_difference, se3
from gscpe.photos import Photo, luminance
from gscpe.refinement import LucasKanadeSettings, RefinementObserver, RefinementSettings
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.sampling import sample_bilinear
from gscpe.refinement.template import Template, build_template
from gscpe.render import RenderedView

CAMERA = room_camera(64, 48)


@pytest.fixture
def adam(tool: Callable[[str], Any]) -> Any:
    return tool("adam_baseline")


def photo_of_noise(rng: np.random.Generator) -> ImageLevel:
    """Nothing cancels."""
    shape = (CAMERA.height, CAMERA.width)
    return ImageLevel(rng.random(shape).astype(np.float32), np.ones(shape, dtype=bool), CAMERA)


def template_of_room() -> Template:
    """Away from the border: a pixel that comes or goes changes the mean by a jump."""
    shot = room().shoot(CAMERA, ROOM_POSE)
    inner = np.zeros(shot.depth.shape, dtype=bool)
    inner[8:-8, 8:-8] = True
    level = AnchorLevel(luminance(shot.rgb.astype(np.float32)), inner, CAMERA, shot.depth)
    template = build_template(level, LucasKanadeSettings(min_pixels=8))
    assert template is not None
    return template


@pytest.mark.parametrize("loss", ["l1", "l2"])
@pytest.mark.parametrize("length", [1.0, 2.5])
def test_gradient(loss: str, length: float, adam: Any, rng: np.random.Generator) -> None:
    """Against central differences, all seven numbers. In a smooth photo: where a pixel leaves
    the four that it is interpolated from, the derivative jumps."""
    smooth = gaussian_filter(photo_of_noise(rng).image, 2.0)
    template, photo = template_of_room(), ImageLevel(smooth, photo_of_noise(rng).valid, CAMERA)
    transform = se3.exp([0.02, -0.03, 0.05, 0.01, 0.03, -0.02])
    parameters = np.concatenate(se3.to_quaternion_translation(transform))
    parameters[:4] *= length

    def loss_at(at: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([adam.photometric_loss(template, photo, at, loss)[0]])

    _, gradient = adam.photometric_loss(template, photo, parameters, loss)
    numeric = numeric_jacobian(loss_at, parameters, step=2e-5)[0]
    np.testing.assert_allclose(gradient, numeric, atol=0.01 * np.abs(numeric).max())
    assert np.abs(numeric).min() > 0
    assert abs(gradient[:4] @ parameters[:4]) < 1e-6 * np.abs(gradient).max()


def test_gradient_of_a_quaternion(adam: Any, rng: np.random.Generator) -> None:
    weights = rng.normal(size=(3, 3))
    for _ in range(10):
        pose = se3.from_rotation_translation(random_rotation(rng), np.zeros(3))
        quaternion = rng.uniform(0.5, 2.0) * se3.to_quaternion_translation(pose)[0]

        def function(q: NDArray[np.float64]) -> NDArray[np.float64]:
            rotation = se3.from_quaternion_translation(q, np.zeros(3))[:3, :3]
            return np.array([np.sum(weights * rotation)])

        expected = numeric_jacobian(function, quaternion)[0]
        np.testing.assert_allclose(
            adam.quaternion_gradient(quaternion, weights), expected, atol=1e-6
        )


def test_samples_are_those_of_the_library(adam: Any, rng: np.random.Generator) -> None:
    photo = photo_of_noise(rng)
    photo.valid[20:23, 30:34] = False
    u, v = (rng.uniform(-2, size + 2, 2000).astype(np.float32) for size in (64, 48))
    values, by_u, by_v, inside = adam.sample_with_gradient(photo, u, v)
    expected, expected_inside = sample_bilinear(photo.image, photo.valid, u, v)
    np.testing.assert_array_equal(inside, expected_inside)
    np.testing.assert_allclose(values[inside], expected[inside], atol=1e-6)
    ahead, ahead_inside = sample_bilinear(photo.image, photo.valid, u + np.float32(0.01), v)
    same_pixels = inside & ahead_inside & (np.floor(u - 0.5) == np.floor(u - 0.49))
    np.testing.assert_allclose(by_u[same_pixels], (ahead - values)[same_pixels] / 0.01, atol=1e-3)
    assert np.abs(by_v[inside]).mean() > 0.1


def test_the_first_step_is_the_learning_rate(adam: Any, rng: np.random.Generator) -> None:
    """Whatever the gradient's size: that is why it cannot come far."""
    gradient = rng.normal(size=7) * 10.0 ** np.arange(-2, 5)
    step = adam.Adam(adam.AdamSettings(), 7).step(gradient)
    np.testing.assert_allclose(step, -3e-4 * np.sign(gradient), rtol=1e-4)


def test_a_quadratic(adam: Any) -> None:
    """A hundred and more steps of a hundredth reach the minimum of a quadratic bowl."""
    optimizer, at = adam.Adam(adam.AdamSettings(learning_rate=0.01), 2), np.array([1.0, -0.5])
    for _ in range(600):
        at = at + optimizer.step(np.array([2.0, 20.0]) * at)
    np.testing.assert_allclose(at, 0.0, atol=1e-3)


class Seen(RefinementObserver):
    """Poses and anchors of a refinement."""

    def __init__(self) -> None:
        self.poses: list[NDArray[np.float64]] = []
        self.anchors: list[NDArray[np.float64]] = []

    def anchor_rendered(self, view: RenderedView) -> None:
        self.anchors.append(view.cam_from_world)

    def iterated(self, photo_from_anchor: NDArray[np.float64]) -> None:
        self.poses.append(photo_from_anchor @ self.anchors[-1])


@pytest.mark.parametrize("loss", ["l1", "l2"])
def test_it_comes_nearer(loss: str, adam: Any) -> None:
    """A wall 2 m away, from 0.5 cm and 0.15 degrees off."""
    camera = room_camera(160, 120)
    photo = Photo(wall().shoot(camera, np.eye(4)).uint8, camera)
    start = se3.exp([0.003, -0.003, 0.003, *np.radians([0.1, -0.1, 0.05])])
    seen, settings = Seen(), adam.AdamSettings(loss=loss)
    found = adam.refine_by_adam(RayCastRenderer(wall()), photo, start, settings, seen)
    begin, end = (pose_difference(pose, np.eye(4)) for pose in (start, found))
    assert end.distance < 0.6 * begin.distance
    assert end.degrees < 0.6 * begin.degrees
    assert len(seen.poses) == 3 * 20
    np.testing.assert_allclose(seen.poses[-1], found)


def test_it_renders_anew_when_it_has_left_the_anchor(adam: Any) -> None:
    """3 cm off it moves on by up to 0.6 cm a level; at the truth it rests."""
    camera = room_camera(160, 120)
    photo = Photo(wall().shoot(camera, np.eye(4)).uint8, camera)
    for start, anchors in ((np.eye(4), {1}), (se3.exp([0.03, 0, 0, 0, 0, 0]), {2, 3})):
        renderer, seen = RayCastRenderer(wall()), Seen()
        adam.refine_by_adam(renderer, photo, start, adam.AdamSettings(), seen)
        assert len(seen.anchors) in anchors
        views = RefinementSettings().visibility.views
        assert renderer.renders == (1 + views) * len(seen.anchors)
