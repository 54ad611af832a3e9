# SPDX-License-Identifier: Apache-2.0
"""Local correlation: of what shows, whatever the light, and never beyond 1."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gscpe.render import local_correlation

SHAPE = (120, 160)


def texture(
    rng: np.random.Generator, contrast: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    picture = gaussian_filter(rng.normal(size=SHAPE), 1.5)
    return np.asarray(0.5 + contrast * picture / picture.std(), dtype=np.float32)


@pytest.mark.parametrize("contrast", [0.005, 0.01, 0.02, 0.05, 0.2])
def test_a_picture_is_like_itself_and_no_more(contrast: float, rng: np.random.Generator) -> None:
    """Also where only the strongest places of a pale one count as texture."""
    picture = texture(rng, contrast)
    picture[:40] = 0.5 + 6.0 * (picture[:40] - 0.5)
    found = local_correlation(picture, picture, np.ones(SHAPE, dtype=bool))
    assert 0.8 < found <= 1.0 + 1e-6


def test_light_does_not_count(rng: np.random.Generator) -> None:
    picture, valid = texture(rng, 0.1), np.ones(SHAPE, dtype=bool)
    shaded = (0.6 * picture + np.linspace(0.0, 0.3, SHAPE[1], dtype=np.float32)).astype(np.float32)
    assert local_correlation(picture, shaded, valid) > 0.95
    assert local_correlation(picture, 1.0 - picture, valid) < -0.8
    assert abs(local_correlation(picture, texture(rng, 0.1), valid)) < 0.1


def test_nothing_to_compare(rng: np.random.Generator) -> None:
    flat, valid = np.full(SHAPE, 0.5, dtype=np.float32), np.ones(SHAPE, dtype=bool)
    assert np.isnan(local_correlation(flat, flat, valid))
    assert np.isnan(local_correlation(texture(rng, 0.1), flat, np.zeros(SHAPE, dtype=bool)))
    assert abs(local_correlation(texture(rng, 0.1), flat, valid)) < 0.05
