# SPDX-License-Identifier: Apache-2.0
"""Interpolation and gradients: exact on linear images, pixel centres at (0.5, 0.5)."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gscpe.refinement.sampling import gradient, sample_bilinear

HEIGHT, WIDTH = 11, 17


def linear_image() -> NDArray[np.float32]:
    """0.1 + 0.03 u - 0.02 v at the pixel centres."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    return np.asarray(0.1 + 0.03 * u - 0.02 * v, dtype=np.float32)


def sample(
    image: NDArray[np.float32], valid: NDArray[np.bool_], pixels: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    u, v = pixels.T.astype(np.float32)
    return sample_bilinear(image, valid, u, v)


ALL_VALID = np.ones((HEIGHT, WIDTH), dtype=bool)


def test_linear_images_are_interpolated_exactly(rng: np.random.Generator) -> None:
    """To a millionth: cv2.remap, which rounds to 1/32 px, would be off by up to 5e-4."""
    pixels = rng.uniform([0.5, 0.5], [WIDTH - 0.5, HEIGHT - 0.5], (500, 2))
    values, inside = sample(linear_image(), ALL_VALID, pixels)
    assert inside.all()
    np.testing.assert_allclose(values, 0.1 + pixels @ [0.03, -0.02], atol=1e-6)


def test_pixel_centres_give_the_pixels(rng: np.random.Generator) -> None:
    image = rng.uniform(size=(HEIGHT, WIDTH)).astype(np.float32)
    row, column = np.mgrid[0 : HEIGHT - 1, 0 : WIDTH - 1]
    centres = np.stack([column.ravel(), row.ravel()], axis=1) + 0.5
    values, inside = sample(image, ALL_VALID, centres)
    assert inside.all()
    np.testing.assert_array_equal(values, image[:-1, :-1].ravel())


@given(st.floats(-3, WIDTH + 3), st.floats(-3, HEIGHT + 3))
def test_inside_means_between_pixel_centres(u: float, v: float) -> None:
    pixel = np.array([[u, v]]).astype(np.float32).astype(np.float64)
    _, inside = sample(linear_image(), ALL_VALID, pixel)
    (u, v), margin = pixel[0], 1e-5
    if 0.5 <= u < WIDTH - 0.5 - margin and 0.5 <= v < HEIGHT - 0.5 - margin:
        assert inside[0]
    if u < 0.5 or v < 0.5 or u >= WIDTH - 0.5 or v >= HEIGHT - 0.5:
        assert not inside[0]


def test_all_four_pixels_must_be_valid() -> None:
    valid = ALL_VALID.copy()
    valid[4, 6] = False  # its centre is (6.5, 4.5)
    near = np.array([[5.6, 3.6], [7.4, 3.6], [5.6, 5.4], [7.4, 5.4], [6.5, 4.5]])
    beside = np.array([[5.4, 3.6], [7.6, 4.5], [6.5, 3.4], [6.5, 5.6], [2.0, 2.0]])
    assert not sample(linear_image(), valid, near)[1].any()
    values, inside = sample(linear_image(), valid, beside)
    assert inside.all()
    np.testing.assert_allclose(values, 0.1 + beside @ [0.03, -0.02], atol=1e-6)


def test_gradient_of_a_linear_image() -> None:
    by_u, by_v = gradient(linear_image())
    assert by_u.dtype == by_v.dtype == np.float32
    np.testing.assert_allclose(by_u[1:-1, 1:-1], 0.03, atol=1e-6)
    np.testing.assert_allclose(by_v[1:-1, 1:-1], -0.02, atol=1e-6)


def test_gradient_is_centred() -> None:
    """A parabola's derivative at the pixel itself, not between two pixels."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    by_u, by_v = gradient(np.asarray(0.01 * u**2 + 0.02 * v**2, dtype=np.float32))
    np.testing.assert_allclose(by_u[1:-1, 1:-1], (0.02 * u)[1:-1, 1:-1], atol=1e-5)
    np.testing.assert_allclose(by_v[1:-1, 1:-1], (0.04 * v)[1:-1, 1:-1], atol=1e-5)
