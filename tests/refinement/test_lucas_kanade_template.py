# SPDX-License-Identifier: Apache-2.0
"""The template's analytic derivatives against central differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import numeric_jacobian
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

from gscpe.geometry import Camera, se3
from gscpe.geometry.projection import pixel_centres, project, transform_points
from gscpe.refinement import LucasKanadeSettings
from gscpe.refinement.pyramid import AnchorLevel
from gscpe.refinement.template import Template, build_template

CAMERA = room_camera(80, 60)


def linear(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.2 + 0.004 * u + 0.003 * v


def waves(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.5 + 0.2 * np.sin(0.11 * u + 0.03 * v) + 0.2 * np.cos(0.12 * v - 0.04 * u)


def anchor(values: NDArray[np.float64], camera: Camera = CAMERA) -> AnchorLevel:
    """An anchor of any intensities with the depth of the room."""
    depth = room().shoot(camera, ROOM_POSE).depth
    return AnchorLevel(values.astype(np.float32), np.ones(depth.shape, bool), camera, depth)


def template_of(level: AnchorLevel, **settings: Any) -> Template:
    template = build_template(level, LucasKanadeSettings(**settings))
    assert template is not None
    return template


@pytest.mark.parametrize(("image", "tolerance"), [(linear, 1e-3), (waves, 0.02)])
def test_jacobian(image: object, tolerance: float) -> None:
    """``I_a(project(exp(delta) X))`` by each of delta's six numbers, in every pixel.

    Scharr's gradient is exact on the linear image, and 2% off at most (of the largest
    derivative) on waves that are 50 px long.
    """
    assert callable(image)
    u, v = pixel_centres(CAMERA).transpose(2, 0, 1)
    template = template_of(anchor(image(u, v)))
    points = template.points.T.astype(np.float64)

    def intensity(delta: NDArray[np.float64]) -> NDArray[np.float64]:
        pixels = project(CAMERA, transform_points(se3.exp(delta), points))
        return np.asarray(image(*pixels.T))

    np.testing.assert_allclose(template.intensities, intensity(np.zeros(6)), atol=1e-6)
    numeric = numeric_jacobian(intensity, np.zeros(6))
    error = np.abs(template.jacobian - numeric).max(axis=0)
    assert np.all(error < tolerance * np.abs(numeric).max(axis=0)), error


def test_motion_is_the_mean_squared_motion_of_pixels(rng: np.random.Generator) -> None:
    camera = room_camera(64, 48)  # so small that no pixel is skipped
    u, v = pixel_centres(camera).transpose(2, 0, 1)
    template = template_of(anchor(waves(u, v), camera), min_pixels=8)
    points = template.points.T.astype(np.float64)
    at_rest = project(camera, points)
    for _ in range(10):
        delta = 1e-5 * rng.normal(size=6)
        moved = project(camera, transform_points(se3.exp(delta), points)) - at_rest
        expected = np.mean(np.sum(moved**2, axis=1))
        assert delta @ template.motion @ delta == pytest.approx(expected, rel=1e-3)


def test_points_lie_behind_the_pixel_centres() -> None:
    level = anchor(np.full((60, 80), 0.5))
    points = template_of(level).points.T.astype(np.float64)
    inner = pixel_centres(CAMERA)[1:-1, 1:-1].reshape(-1, 2)
    np.testing.assert_allclose(project(CAMERA, points), inner, atol=1e-4)
    np.testing.assert_array_equal(points[:, 2], level.depth[1:-1, 1:-1].ravel())


def test_gradients_are_made_of_valid_pixels_only() -> None:
    """A masked pixel, whatever its value, leaves no trace; Scharr's kernel sees diagonals too."""
    u, v = pixel_centres(CAMERA).transpose(2, 0, 1)
    level = anchor(linear(u, v))
    level.image[30, 40] = 1e6
    level.valid[30, 40] = False
    template = template_of(level)
    assert template.intensities.max() < 1.0
    assert np.abs(template.jacobian).max() < 2.0


def test_thinning_is_even_and_repeatable() -> None:
    """About as many pixels as asked for, in every part of the picture."""
    u, v = pixel_centres(CAMERA).transpose(2, 0, 1)
    kept = template_of(anchor(waves(u, v)), max_template_pixels=800)
    assert len(kept.intensities) == pytest.approx(800, rel=0.05)
    pixels = project(CAMERA, kept.points.T.astype(np.float64))
    across, down = pixels.T
    counts, _, _ = np.histogram2d(across, down, bins=(4, 3), range=((1, 79), (1, 59)))
    assert counts.min() > 0.6 * 800 / 12
    again = template_of(anchor(waves(u, v)), max_template_pixels=800)
    np.testing.assert_array_equal(again.points, kept.points)


def test_too_few_pixels_make_no_template() -> None:
    level = anchor(np.full((60, 80), 0.5))
    level.valid[:] = False
    level.valid[10:20, 10:20] = True  # 64 with a full neighbourhood
    assert build_template(level, LucasKanadeSettings(min_pixels=65)) is None
    assert len(template_of(level, min_pixels=64).intensities) == 64
