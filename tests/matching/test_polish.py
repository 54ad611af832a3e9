# SPDX-License-Identifier: Apache-2.0
"""Polishing of matches between shifted textures, whose true displacement is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gscpe.errors import SettingsError
from gscpe.matching import PolishSettings
from gscpe.matching.polish import for_polishing, normalize_locally, polish

SETTINGS = PolishSettings()
WIDTH, HEIGHT = 160, 120


def texture(shift: tuple[float, float] = (0.0, 0.0), zoom: float = 1.0) -> NDArray[np.uint8]:
    """A sum of waves: what is at ``p`` without a shift is at ``zoom * p + shift``, with
    centres of pixels at a half."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    x, y = (x - shift[0]) / zoom, (y - shift[1]) / zoom
    grey = np.full((HEIGHT, WIDTH), 128.0)
    for angle, phase, length in zip(
        *rng.uniform(0, 2 * np.pi, (2, 40)), rng.uniform(5, 25, 40), strict=True
    ):
        grey += 12 * np.sin((x * np.cos(angle) + y * np.sin(angle)) * 2 * np.pi / length + phase)
    grey = np.clip(grey, 0, 255)
    return np.repeat(np.rint(grey)[:, :, None], 3, axis=2).astype(np.uint8)


def points(rng: np.random.Generator, count: int = 200) -> NDArray[np.float64]:
    """Away from the borders, at centres of pixels."""
    whole = rng.integers((20, 20), (WIDTH - 20, HEIGHT - 20), (count, 2))
    return np.asarray(whole + 0.5, dtype=np.float64)


def polished(
    a: NDArray[np.uint8],
    b: NDArray[np.uint8],
    in_a: NDArray[np.float64],
    in_b: NDArray[np.float64],
    settings: PolishSettings = SETTINGS,
) -> NDArray[np.float64]:
    return polish(for_polishing(a, settings), for_polishing(b, settings), in_a, in_b, settings)


@pytest.mark.parametrize("shift", [(0.3, -0.4), (5.5, 2.25), (-3.7, 0.35)])
@pytest.mark.parametrize(("gain", "bias"), [(1.0, 0.0), (0.6, 40.0), (0.7, -10.0)])
def test_matches_of_whole_pixels_become_exact(
    shift: tuple[float, float], gain: float, bias: float, rng: np.random.Generator
) -> None:
    fixed = texture()
    moving = np.clip(np.rint(gain * texture(shift) + bias), 0, 255).astype(np.uint8)
    at = points(rng)
    true = at + shift
    start = np.rint(true + rng.uniform(-0.5, 0.5, true.shape) - 0.5) + 0.5
    assert np.median(np.linalg.norm(start - true, axis=1)) > 0.25
    result = polished(fixed, moving, at, start)
    assert result.dtype == np.float64
    assert np.median(np.linalg.norm(result - true, axis=1)) < 0.05
    np.testing.assert_allclose(np.median(result - true, axis=0), [0, 0], atol=0.02)


def test_pixel_centres_are_at_a_half(rng: np.random.Generator) -> None:
    """Enlarged about the corner of the image, which is the origin for no other convention: if
    coordinates were off by a half, points would be by 0.05 pixels, all to one side."""
    at = rng.uniform((20, 20), (WIDTH - 40, HEIGHT - 40), (300, 2))
    true = 1.1 * at
    result = polished(texture(), texture(zoom=1.1), at, true + rng.uniform(-0.4, 0.4, true.shape))
    np.testing.assert_allclose(np.median(result - true, axis=0), [0, 0], atol=0.02)


def test_a_brightness_that_changes_across_the_image(rng: np.random.Generator) -> None:
    """What normalizing is for: the same without it is pulled aside."""
    shadow = np.linspace(1.0, 0.35, WIDTH)[None, :, None]
    moving = np.rint(texture((0.4, 0.3)) * shadow).astype(np.uint8)
    at = points(rng)
    true = at + np.array([0.4, 0.3])
    result = polished(texture(), moving, at, at)
    grey, moving_grey = (
        np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
        for image in (texture(), moving)
    )
    without = polish(grey, moving_grey, at, at, SETTINGS)
    error, error_without = (
        np.median(np.linalg.norm(each - true, axis=1)) for each in (result, without)
    )
    assert error < 0.1
    assert error_without > 2 * error


def test_what_cannot_be_aligned_stays(rng: np.random.Generator) -> None:
    at = points(rng)
    flat = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    np.testing.assert_array_equal(polished(flat, flat, at, at + 0.25), at + 0.25)
    beyond = at + np.array([1000.0, -1000.0])
    np.testing.assert_array_equal(polished(texture(), texture(), at, beyond), beyond)


def test_none_moves_farther_than_it_may(rng: np.random.Generator) -> None:
    a, b = (rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8) for _ in range(2))
    at = points(rng)
    for limit in (0.5, 3.0):
        moved = polished(a, b, at, at, PolishSettings(max_shift=limit)) - at
        assert 0 < np.linalg.norm(moved, axis=1).max() <= limit + 1e-5
        assert np.any(np.all(moved == 0, axis=1))


def test_nothing_to_polish(rng: np.random.Generator) -> None:
    nothing = np.zeros((0, 2))
    assert polished(texture(), texture(), nothing, nothing).shape == (0, 2)
    at = points(rng)
    assert for_polishing(texture(), None) is None
    np.testing.assert_array_equal(polish(None, None, at, at + 1.0, None), at + 1.0)


def test_images_of_two_sizes(rng: np.random.Generator) -> None:
    at = points(rng)
    true = at + np.array([0.4, -0.3])
    expected = polished(texture(), texture((0.4, -0.3)), at, at)
    smaller = texture((0.4, -0.3))[: HEIGHT - 5, : WIDTH - 3]
    for a, b in ((texture(), smaller), (texture()[: HEIGHT - 5], texture((0.4, -0.3)))):
        result = polished(a, b, at, at)
        assert np.median(np.linalg.norm(result - true, axis=1)) < 0.05
        assert np.median(np.linalg.norm(result - expected, axis=1)) < 0.01


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (8, 8)])
def test_tiny_images(size: tuple[int, int], rng: np.random.Generator) -> None:
    tiny = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
    at = np.array([[0.5, 0.5]])
    assert np.linalg.norm(polished(tiny, tiny, at, at) - at) <= SETTINGS.max_shift


def test_the_scale_of_the_normalization_is_that_of_the_settings() -> None:
    for sigma in (3.0, 20.0):
        normalized = for_polishing(texture(), PolishSettings(sigma=sigma))
        assert normalized is not None
        np.testing.assert_array_equal(normalized, normalize_locally(texture(), sigma))
    assert np.any(normalize_locally(texture(), 3.0) != normalize_locally(texture(), 20.0))


@pytest.mark.parametrize(
    "wrong", [{"window": 4}, {"window": 1}, {"max_shift": 0.0}, {"sigma": -1.0}]
)
def test_impossible_settings(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        PolishSettings(**wrong)  # type: ignore[arg-type]
