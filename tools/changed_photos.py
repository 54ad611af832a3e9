# SPDX-License-Identifier: Apache-2.0
"""Photos as worse light, lenses and hands would have made them, for the benchmarks.

Each function takes and returns an (H, W, 3) uint8 RGB image. They work on the stored values,
without undoing the camera's gamma; but for :func:`dimly_lit` and :func:`lit_by_one_lamp`, which
take the photo again with less light, as a camera whose exposure cannot be longer. What is left to
chance is always the same for an image; where parts of the photo are replaced, ``seed`` chooses
others.
"""

from __future__ import annotations

from functools import partial
from typing import Callable

import cv2
import numpy as np
import skimage.data
from numpy.typing import NDArray

from gscpe.arrays import UInt8Array


def exposed(image: UInt8Array, factor: float) -> UInt8Array:
    """Times so much light; what is too bright is clipped."""
    return _bytes(image * np.float64(factor))


def with_gamma(image: UInt8Array, gamma: float) -> UInt8Array:
    """Each value in [0, 1] to this power."""
    return _bytes(255.0 * (image / 255.0) ** gamma)


def colour_cast(image: UInt8Array, red: float, green: float, blue: float) -> UInt8Array:
    """The channels times these factors, clipped."""
    return _bytes(image * np.array([red, green, blue]))


def vignetted(image: UInt8Array, corner: float) -> UInt8Array:
    """Brightness falls with the fourth power of the cosine of the angle from the middle, to
    the share ``corner`` in the corners."""
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width] + 0.5 - np.array([height, width])[:, None, None] / 2
    radius_squared = (x**2 + y**2) / ((width / 2) ** 2 + (height / 2) ** 2)
    # cos^4 = (1 + tan^2)^-2, and tan grows with the radius.
    tangent_squared = radius_squared * (corner**-0.5 - 1.0)
    return _bytes(image * (1.0 + tangent_squared)[:, :, None] ** -2)


def noisy(image: UInt8Array, sigma: float) -> UInt8Array:
    """Gaussian noise in every value, independent; always the same for an image."""
    rng = np.random.default_rng(int(image.sum()))
    return _bytes(image + sigma * rng.standard_normal(image.shape))


def motion_blurred(image: UInt8Array, pixels: int) -> UInt8Array:
    """Moved sideways by so many pixels during the exposure, as much to the left as to the
    right, so that the true pose stays in the middle."""
    kernel = np.full((1, pixels), 1.0 / pixels)
    blurred = cv2.filter2D(image, cv2.CV_64F, kernel, borderType=cv2.BORDER_REPLICATE)
    return _bytes(np.asarray(blurred))


def occluded(image: UInt8Array, area_share: float) -> UInt8Array:
    """A photograph of a cup covers this share, a rectangle of the image's shape right and below
    the middle."""
    height, width = image.shape[:2]
    rows, columns = (round(side * area_share**0.5) for side in (height, width))
    top, left = (2 * (height - rows)) // 3, (2 * (width - columns)) // 3
    result = image.copy()
    result[top : top + rows, left : left + columns] = _cup(columns, rows)
    return result


def half_covered(image: UInt8Array) -> UInt8Array:
    """The left half hidden by the same cup."""
    height, width = image.shape[:2]
    result = image.copy()
    result[:, : width // 2] = _cup(width // 2, height)
    return result


def dark_and_blurred(image: UInt8Array) -> UInt8Array:
    """A quarter of the light, moved by 11 pixels while it was exposed, with the noise of it."""
    blurred = cv2.filter2D(image.astype(np.float64), -1, np.full((1, 11), 1 / 11)) / 4
    return _bytes(blurred + np.random.default_rng(0).normal(0.0, 3.0, image.shape))


_GAMMA = 2.2
_ELECTRONS = 4000.0
"""That a pixel of a small sensor holds where it is white."""
_READ_NOISE = 4.0
"""Electrons."""


def _taken_again(image: UInt8Array, light: NDArray[np.float64]) -> UInt8Array:
    """With a share of the light, (H, W) or one for all: the electrons are counted, with shot noise
    and read noise, and stored with gamma in eight bits. Always the same for an image."""
    share = light[..., None] if light.ndim else light
    electrons = _ELECTRONS * share * (image / 255.0) ** _GAMMA
    rng = np.random.default_rng(int(image.sum()))
    counted = rng.poisson(electrons) + _READ_NOISE * rng.standard_normal(image.shape)
    return _bytes(255.0 * np.clip(counted / _ELECTRONS, 0.0, 1.0) ** (1.0 / _GAMMA))


def dimly_lit(image: UInt8Array, light: float) -> UInt8Array:
    """A share of the light, exposed as before."""
    return _taken_again(image, np.asarray(light))


def dark(image: UInt8Array, factor: float) -> UInt8Array:
    """The stored values times a factor, with noise of one of them: much darker than as much less
    light."""
    rng = np.random.default_rng(int(image.sum()))
    return _bytes(factor * image.astype(np.float64) + rng.standard_normal(image.shape))


def lit_by_one_lamp(image: UInt8Array, ambient: float = 0.02, spread: float = 0.25) -> UInt8Array:
    """A spot left of the middle, with so much of the width in its standard deviation; elsewhere,
    hardly any light."""
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width] + 0.5
    squared = (x - 0.38 * width) ** 2 + (y - 0.45 * height) ** 2
    return _taken_again(image, ambient + np.exp(-0.5 * squared / (spread * width) ** 2))


def replaced(
    image: UInt8Array, area_share: float, other: UInt8Array | None = None, seed: int = 0
) -> UInt8Array:
    """Blocks of a sixth of each side, strewn over so much of the photo, show what another photo
    (the cup) shows there: furniture moved, and people came."""
    height, width = image.shape[:2]
    other = _cup(width, height) if other is None else other
    rng = _chance(image, seed)
    chosen = rng.permutation(36)[: round(36 * area_share)]
    result = image.copy()
    for block in chosen:
        rows = slice((block // 6) * height // 6, (block // 6 + 1) * height // 6)
        columns = slice((block % 6) * width // 6, (block % 6 + 1) * width // 6)
        result[rows, columns] = other[rows, columns]
    return result


def with_people(image: UInt8Array, count: int, seed: int = 0) -> UInt8Array:
    """So many people stand in front of the camera, each nearly as high as the photo and a sixth of
    its width; their clothes are of the astronaut's portrait."""
    height, width = image.shape[:2]
    rng = _chance(image, seed)
    portrait: UInt8Array = skimage.data.astronaut()
    result = image.copy()
    for place in (np.arange(count) + rng.uniform(0.25, 0.75, count)) / count:
        wide, high = round(width / 6), round(height * rng.uniform(0.85, 0.95))
        middle, top = wide // 2, high // 8
        figure = np.zeros((high, wide), dtype=np.uint8)
        cv2.ellipse(figure, (middle, top), (wide // 4, top), 0, 0, 360, 1, -1)
        cv2.ellipse(figure, (middle, 3 * high // 8), (middle, high // 5), 0, 0, 360, 1, -1)
        cv2.rectangle(figure, (wide // 6, 3 * high // 8), (wide - wide // 6, high), 1, -1)
        clothes = cv2.resize(portrait, (wide, high), interpolation=cv2.INTER_AREA)
        left = round(place * width) - middle
        columns = np.arange(max(left, 0), min(left + wide, width))
        there = figure[:, columns - left] > 0
        part = result[height - high :, columns]
        part[there] = clothes[:, columns - left][there]
        result[height - high :, columns] = part
    return result


def rearranged(image: UInt8Array, seed: int = 0) -> UInt8Array:
    """Three pieces, each a tenth of the photo, have been moved sideways by a seventh of its width;
    where they stood, there is nothing to see. So three tenths of the photo are wrong, and three
    tenths moved alike."""
    height, width = image.shape[:2]
    rng = _chance(image, seed)
    rows, columns, shift = round(0.36 * height), round(0.28 * width), round(width / 7)
    empty = cv2.GaussianBlur(image, (0, 0), width / 20)
    corners = [
        (int(rng.integers(height - rows)), round((i + 0.15) * (width - columns - shift) / 2.3))
        for i in range(3)
    ]
    result = image.copy()
    for top, left in corners:
        result[top : top + rows, left : left + columns] = empty[
            top : top + rows, left : left + columns
        ]
    for top, left in corners:
        result[top : top + rows, left + shift : left + shift + columns] = image[
            top : top + rows, left : left + columns
        ]
    return result


def _chance(image: UInt8Array, seed: int) -> np.random.Generator:
    return np.random.default_rng([int(image.sum()), seed] if seed else int(image.sum()))


def _cup(width: int, height: int) -> UInt8Array:
    picture: UInt8Array = skimage.data.coffee()
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _bytes(values: NDArray[np.float64]) -> UInt8Array:
    return np.asarray(np.rint(np.clip(values, 0.0, 255.0)), dtype=np.uint8)


CHANGES: dict[str, Callable[[UInt8Array], UInt8Array]] = {
    "exposure x 0.5": partial(exposed, factor=0.5),
    "exposure x 2, clipped": partial(exposed, factor=2.0),
    "gamma 0.7": partial(with_gamma, gamma=0.7),
    "gamma 1.4": partial(with_gamma, gamma=1.4),
    "colour cast (red x 1.2, blue x 0.7)": partial(colour_cast, red=1.2, green=1.0, blue=0.7),
    "vignetting, 40% in the corners": partial(vignetted, corner=0.4),
    "noise, sigma 8/255": partial(noisy, sigma=8.0),
    "motion blur, 5 px": partial(motion_blurred, pixels=5),
    "a quarter covered": partial(occluded, area_share=0.25),
    "a tenth of the light": partial(dimly_lit, light=0.1),
    "a twentieth of the light": partial(dimly_lit, light=0.05),
    "stored values x 0.1": partial(dark, factor=0.1),
    "stored values x 0.05": partial(dark, factor=0.05),
    "one lamp": lit_by_one_lamp,
    "one small lamp": partial(lit_by_one_lamp, ambient=0.005, spread=0.15),
    "30% replaced": partial(replaced, area_share=0.3),
    "50% replaced": partial(replaced, area_share=0.5),
    "three people": partial(with_people, count=3),
    "furniture moved": rearranged,
}

COSTLY = (
    "a quarter covered",
    "stored values x 0.1",
    "stored values x 0.05",
    "30% replaced",
    "50% replaced",
    "three people",
    "furniture moved",
)
"""Of which most photos take several times as long, because they are not easy."""

_STREWN: dict[str, Callable[[UInt8Array, int], UInt8Array]] = {
    "30% replaced": lambda image, seed: replaced(image, 0.3, seed=seed),
    "50% replaced": lambda image, seed: replaced(image, 0.5, seed=seed),
    "three people": lambda image, seed: with_people(image, 3, seed),
    "furniture moved": rearranged,
}


def changed(image: UInt8Array, change: str, seed: int = 0) -> UInt8Array:
    """With one of the ``CHANGES``; another seed puts what has moved or come elsewhere."""
    if change in _STREWN:
        return _STREWN[change](image, seed)
    return CHANGES[change](image)
