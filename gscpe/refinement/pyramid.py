# SPDX-License-Identifier: Apache-2.0
"""Image pyramids that keep pixel centres: u at level s is u / 2^s exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import BoolArray, Float32Array
from gscpe.geometry.camera import Camera

_T = TypeVar("_T", np.float32, np.bool_)


@dataclass(frozen=True, eq=False)
class ImageLevel:
    """One level: luminance, (H, W) float32 in [0, 1], where it is valid, and its camera."""

    image: Float32Array
    valid: BoolArray
    camera: Camera


@dataclass(frozen=True, eq=False)
class AnchorLevel(ImageLevel):
    """A level of a render, with its z-depth, (H, W) float32."""

    depth: Float32Array


def _blocks(image: NDArray[_T]) -> tuple[NDArray[_T], ...]:
    """The four images of every second pixel; an odd last row or column is dropped."""
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    return tuple(image[r:height:2, c:width:2] for r in (0, 1) for c in (0, 1))


def halve_mean(image: Float32Array) -> Float32Array:
    """Means of 2x2 pixels; an odd last row or column is dropped."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    even = image[: 2 * height, : 2 * width]
    halved = cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(halved, dtype=np.float32)


def halve_all(valid: BoolArray) -> BoolArray:
    """Whether all of 2x2 pixels are valid."""
    if valid.all():
        return np.ones((valid.shape[0] // 2, valid.shape[1] // 2), dtype=bool)
    a, b, c, d = _blocks(valid)
    return a & b & c & d


def halve_camera(camera: Camera) -> Camera:
    """The camera of the halved image."""
    return replace(
        camera,
        width=camera.width // 2,
        height=camera.height // 2,
        fx=camera.fx / 2,
        fy=camera.fy / 2,
        cx=camera.cx / 2,
        cy=camera.cy / 2,
    )


def photo_pyramid(
    image: Float32Array, valid: BoolArray, camera: Camera, levels: int
) -> tuple[ImageLevel, ...]:
    """The photo at full size and ``levels`` times halved."""
    pyramid = [ImageLevel(image, valid, camera)]
    for _ in range(levels):
        last = pyramid[-1]
        pyramid.append(
            ImageLevel(halve_mean(last.image), halve_all(last.valid), halve_camera(last.camera))
        )
    return tuple(pyramid)


def anchor_pyramid(
    image: Float32Array,
    depth: Float32Array,
    valid: BoolArray,
    camera: Camera,
    levels: int,
    lenient_level: int,
) -> tuple[AnchorLevel, ...]:
    """The anchor at full size and ``levels`` times halved; the mask is halved with it, so
    that all contributing pixels are valid.

    From the halving ``lenient_level`` on, where whole blocks of pixels would have to be valid and
    little were left of a cluttered scene, half of them are enough.
    """
    pyramid = [AnchorLevel(image, valid, camera, depth)]
    share = valid.astype(np.float32)
    for level in range(1, levels + 1):
        last = pyramid[-1]
        share = halve_mean(share)
        pyramid.append(
            AnchorLevel(
                halve_mean(last.image),
                halve_all(last.valid) if level < lenient_level else share >= 0.5,
                halve_camera(last.camera),
                halve_mean(last.depth),
            )
        )
    return tuple(pyramid)
