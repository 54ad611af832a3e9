# SPDX-License-Identifier: Apache-2.0
"""Local means against the Gaussian window that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gscpe.photos.local_window import at_full_size, local_mean


@pytest.mark.parametrize("sigma", [1.0, 3.0, 8.0, 20.0])
@pytest.mark.parametrize("shape", [(240, 320), (237, 315)])
def test_as_the_gaussian(sigma: float, shape: tuple[int, int], rng: np.random.Generator) -> None:
    """Away from the borders, where there is no one definition; also of sizes that are no multiple
    of anything."""
    image = rng.normal(size=shape).astype(np.float32)
    expected = gaussian_filter(image.astype(np.float64), sigma)
    found = at_full_size(local_mean(image, sigma), image)
    assert found.shape == shape
    inner = (slice(60, -60), slice(60, -60))
    error = np.std(found[inner] - expected[inner]) / np.std(expected[inner])
    assert error < 0.15


def test_it_is_not_moved() -> None:
    """A slope stays where it is, whatever the size."""
    image = np.tile(np.arange(157, dtype=np.float32), (93, 1))
    found = at_full_size(local_mean(image, 8.0), image)
    np.testing.assert_allclose(found[:, 40:-40], image[:, 40:-40], atol=0.01)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (5, 40)])
def test_tiny_images(shape: tuple[int, int]) -> None:
    image = np.full(shape, 3.0, dtype=np.float32)
    np.testing.assert_allclose(at_full_size(local_mean(image, 8.0), image), image)
