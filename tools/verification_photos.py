# SPDX-License-Identifier: Apache-2.0
"""The photos of tools/bench_verification.py: of RedKitchen, and of what is not RedKitchen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Callable, Iterator, Sequence

import cv2
import numpy as np
import skimage.data
from changed_photos import dark_and_blurred, half_covered

from gscpe import Camera, read_image
from gscpe.arrays import Float64Array, UInt8Array
from gscpe.scene.query_list import Query

# All pictures of real things inside the scikit-image wheel, and its pages and drawings.
_SKIMAGE = (
    *("astronaut", "brick", "camera", "cell", "chelsea", "clock", "coffee", "coins"),
    *("colorwheel", "grass", "gravel", "hubble_deep_field", "immunohistochemistry"),
    *("microaneurysms", "moon", "page", "retina", "rocket", "text"),
)
_PAIR = ("motorcycle left", "motorcycle right")
_TILE = (320, 240)
"""Width and height of the tiles of larger pictures; they are then enlarged to the camera's."""


@dataclass(frozen=True)
class Sample:
    """A photo to localize: ``truth`` is its (4, 4) pose, None where it shows another place."""

    kind: str
    name: str
    camera: Camera
    load: Callable[[], UInt8Array]
    truth: Float64Array | None = None


def of_redkitchen(
    data: Path, queries: Sequence[Query], truth: dict[str, Float64Array], every_changed: int
) -> Iterator[Sample]:
    """The queries, and every N-th of them with less to see (0: none)."""

    def sample(kind: str, query: Query, change: Callable[[UInt8Array], UInt8Array]) -> Sample:
        path = data / "queries" / query.name
        pose = truth[query.name]
        return Sample(kind, query.name, query.camera, lambda: change(read_image(path)), pose)

    for query in queries:
        yield sample("RedKitchen", query, lambda image: image)
    for query in queries[::every_changed] if every_changed else ():
        yield sample("RedKitchen, half covered", query, half_covered)
        yield sample("RedKitchen, dark and blurred", query, dark_and_blurred)


def of_elsewhere(data: Path, queries: Sequence[Query], every_changed: int) -> Iterator[Sample]:
    """Other pictures, tiles of them, and queries changed into what no camera sees."""
    camera = queries[0].camera

    def picture(kind: str, name: str, load: Callable[[], UInt8Array]) -> Sample:
        return Sample(f"scikit-image{kind}", name, camera, lambda: filling(load(), camera))

    pictures = {name: partial(_picture, name) for name in (*_SKIMAGE, *_PAIR)}
    for name, load in pictures.items():
        yield picture("", name, load)
    for name, load in pictures.items():
        yield picture(", mirrored", name, partial(_mirrored, load))
    for name, load in pictures.items():
        for corner, tile in tiles(load()):
            yield picture(", tile", f"{name} {corner}", partial(np.asarray, tile))
    changes: dict[str, Callable[[UInt8Array], UInt8Array]] = {
        "query mirrored": lambda image: image[:, ::-1],
        "query top to bottom": lambda image: image[::-1],  # mirrored as well: no camera sees it
        "query, 4x4 blocks shuffled": lambda image: shuffled(image, 4),
        "query, 2x2 blocks shuffled": lambda image: shuffled(image, 2),
    }
    for kind, change in changes.items():
        for query in queries[::every_changed]:
            path = data / "queries" / query.name
            yield Sample(kind, query.name, query.camera, partial(_changed, path, change))


def _picture(name: str) -> UInt8Array:
    if name in _PAIR:
        return np.asarray(skimage.data.stereo_motorcycle()[_PAIR.index(name)])
    return np.asarray(getattr(skimage.data, name)())


def _mirrored(load: Callable[[], UInt8Array]) -> UInt8Array:
    return load()[:, ::-1]


def _changed(path: Path, change: Callable[[UInt8Array], UInt8Array]) -> UInt8Array:
    return np.ascontiguousarray(change(read_image(path)))


def filling(image: UInt8Array, camera: Camera) -> UInt8Array:
    """A picture, grey or colour, cropped and resized to the camera's image."""
    colour = np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image[:, :, :3]
    scale = max(camera.width / colour.shape[1], camera.height / colour.shape[0])
    size = (int(np.ceil(colour.shape[1] * scale)), int(np.ceil(colour.shape[0] * scale)))
    kernel = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    resized = cv2.resize(np.ascontiguousarray(colour), size, interpolation=kernel)
    return np.ascontiguousarray(resized[: camera.height, : camera.width], dtype=np.uint8)


def tiles(image: UInt8Array) -> Iterator[tuple[str, UInt8Array]]:
    """Tiles that do not overlap, of pictures that hold at least two."""
    columns, rows = image.shape[1] // _TILE[0], image.shape[0] // _TILE[1]
    if columns * rows < 2:
        return
    for row in range(rows):
        for column in range(columns):
            top, left = row * _TILE[1], column * _TILE[0]
            yield f"{row},{column}", image[top : top + _TILE[1], left : left + _TILE[0]]


def shuffled(image: UInt8Array, blocks: int) -> UInt8Array:
    """The image with its blocks x blocks parts moved, none of them left in its place."""
    height, width = image.shape[0] // blocks, image.shape[1] // blocks
    order = np.arange(blocks * blocks)
    rng = np.random.default_rng(int(image.sum()))
    while np.any(order == np.arange(len(order))):
        rng.shuffle(order)
    result = image.copy()
    for to, origin in enumerate(order):
        top, left = (to // blocks) * height, (to % blocks) * width
        from_top, from_left = (origin // blocks) * height, (origin % blocks) * width
        result[top : top + height, left : left + width] = image[
            from_top : from_top + height, from_left : from_left + width
        ]
    return result
