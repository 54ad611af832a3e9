# SPDX-License-Identifier: Apache-2.0
"""Image pyramids: a pixel (u, v) is (u, v) / 2^s at level s, exactly, whatever the size."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from gscpe.geometry import Camera
from gscpe.geometry.projection import pixel_centres, project, unproject
from gscpe.photos import luminance
from gscpe.refinement.pyramid import (
    anchor_pyramid,
    halve_all,
    halve_camera,
    halve_mean,
    photo_pyramid,
)

SIZES = [(64, 48), (61, 47), (60, 47), (61, 48), (13, 9)]


def camera_of(width: int, height: int) -> Camera:
    return Camera.pinhole(width, height, fx=70.0, fy=55.0, cx=0.4 * width, cy=0.55 * height)


def linear_image(camera: Camera) -> NDArray[np.float32]:
    """A function of the ray, not of the pixel: 0.5 + 0.3 x/z - 0.2 y/z."""
    u, v = pixel_centres(camera).transpose(2, 0, 1)
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return np.asarray(0.5 + 0.3 * x - 0.2 * y, dtype=np.float32)


@pytest.mark.parametrize("size", SIZES)
def test_halved_images_show_what_halved_cameras_see(size: tuple[int, int]) -> None:
    camera = camera_of(*size)
    valid = np.ones((size[1], size[0]), dtype=bool)
    levels = photo_pyramid(linear_image(camera), valid, camera, 2)
    assert len(levels) == 3
    for s, level in enumerate(levels):
        assert (level.camera.width, level.camera.height) == (size[0] >> s, size[1] >> s)
        assert level.image.shape == level.valid.shape == (size[1] >> s, size[0] >> s)
        assert level.image.dtype == np.float32
        np.testing.assert_allclose(level.image, linear_image(level.camera), atol=2e-7)


@pytest.mark.parametrize("size", SIZES)
def test_anchor_depth_stays_on_its_rays(size: tuple[int, int]) -> None:
    """Depth that is linear in the pixel: every level's points lie on the same surface."""
    camera = camera_of(*size)
    depth = 2.0 + linear_image(camera)
    valid = np.ones(depth.shape, dtype=bool)
    levels = anchor_pyramid(linear_image(camera), depth, valid, camera, 2, 3)
    for level in levels:
        np.testing.assert_allclose(level.depth, 2.0 + linear_image(level.camera), atol=1e-6)


@pytest.mark.parametrize("size", SIZES)
def test_pixels_scale_with_the_level(size: tuple[int, int], rng: np.random.Generator) -> None:
    camera = camera_of(*size)
    pixels = rng.uniform([0, 0], size, (20, 2))
    points = unproject(camera, pixels, rng.uniform(1, 3, 20))
    half = halve_camera(camera)
    np.testing.assert_allclose(project(half, points), pixels / 2, atol=1e-12)
    np.testing.assert_allclose(project(halve_camera(half), points), pixels / 4, atol=1e-12)


@given(hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=9)))
def test_a_halved_pixel_is_valid_if_all_four_are(valid: NDArray[np.bool_]) -> None:
    halved = halve_all(valid)
    assert halved.shape == (valid.shape[0] // 2, valid.shape[1] // 2)
    for row, column in np.ndindex(halved.shape):
        block = valid[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
        assert halved[row, column] == block.all()


@given(
    hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=9),
        elements=st.floats(0, 1, width=32),
    )
)
def test_a_halved_pixel_is_the_mean_of_four(image: NDArray[np.float32]) -> None:
    halved = halve_mean(image)
    for row, column in np.ndindex(halved.shape):
        block = image[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
        assert halved[row, column] == pytest.approx(block.astype(np.float64).mean(), abs=1e-6)


def test_the_mask_is_halved_with_the_anchor() -> None:
    camera = camera_of(16, 8)
    valid = np.ones((8, 16), dtype=bool)
    valid[3, 5] = False
    image = np.ones((8, 16), dtype=np.float32)
    levels = anchor_pyramid(image, image, valid, camera, 2, 3)
    assert np.argwhere(~levels[1].valid).tolist() == [[1, 2]]
    assert np.argwhere(~levels[2].valid).tolist() == [[0, 1]]


@given(hnp.arrays(bool, (16, 24)))
def test_lenient_levels_need_half_of_their_pixels(valid: NDArray[np.bool_]) -> None:
    """Half of all pixels of the full size; the levels before need all."""
    image, camera = np.ones(valid.shape, np.float32), camera_of(24, 16)
    levels = anchor_pyramid(image, image, valid, camera, 3, 2)
    assert np.array_equal(levels[1].valid, halve_all(valid))
    for level in (2, 3):
        size = 2**level
        blocks = valid.reshape(16 // size, size, 24 // size, size)
        assert np.array_equal(levels[level].valid, blocks.mean(axis=(1, 3)) >= 0.5)


def test_no_levels_leave_the_image_as_it_is() -> None:
    camera = camera_of(16, 8)
    image, valid = linear_image(camera), np.ones((8, 16), dtype=bool)
    (only,) = photo_pyramid(image, valid, camera, 0)
    assert only.image is image
    assert only.camera == camera


def test_luminance_of_bytes_and_floats(rng: np.random.Generator) -> None:
    pixels = rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    expected = (0.299 * pixels[..., 0] + 0.587 * pixels[..., 1] + 0.114 * pixels[..., 2]) / 255
    assert luminance(pixels).dtype == np.float32
    np.testing.assert_allclose(luminance(pixels), expected, atol=1e-6)
    np.testing.assert_allclose(
        luminance(pixels.astype(np.float32) / np.float32(255)), expected, atol=1e-6
    )
    white = np.full((1, 1, 3), 255, np.uint8)
    np.testing.assert_allclose(luminance(white), 1.0, atol=1e-6)
