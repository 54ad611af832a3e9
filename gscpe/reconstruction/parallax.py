# SPDX-License-Identifier: Apache-2.0
"""Whether photos were taken from more than one spot: how far from it is a mere turn of the camera
to explain what two photos share?"""

from __future__ import annotations

from pathlib import Path
from typing import Collection

import numpy as np

from gscpe.arrays import Float64Array

_FOCALS = np.geomspace(0.4, 4.0, 12)  # of the longer side
_LEAST_MATCHES = 15
_LOOKED_AT = 100  # matches of a pair
_TRIALS = 40
_SHARE = 0.75  # of what a photo shares with others: a few partners may be wrong


def parallax(database: Path, names: Collection[str]) -> float:
    """By how much things that two photos share move beyond what turning the camera on the spot
    does, as a share of the longer side: of each photo three quarters of what it shares with others
    moves less, and this is the median over the photos. Zero where photos share nothing.

    The focal length is the one that turning explains best, for where photos are from one spot, a
    model of them has any focal length.

    Args:
        database: of COLMAP, with verified matches.
        names: of the photos that count.
    """
    import pycolmap

    shared: dict[int, list[tuple[int, Float64Array]]] = {}
    with pycolmap.Database.open(database) as stored:
        cameras = {camera.camera_id: camera for camera in stored.read_all_cameras()}
        pixels: dict[int, Float64Array] = {}
        for image in stored.read_all_images():
            if image.name in names:
                camera = cameras[image.camera_id]
                middle = np.array([camera.width / 2, camera.height / 2])
                found = stored.read_keypoints(image.image_id)[:, :2].astype(np.float64)
                pixels[image.image_id] = (found - middle) / max(camera.width, camera.height)
        pairs, geometries = stored.read_two_view_geometries()
    for pair, geometry in zip(pairs, geometries, strict=True):
        a, b = pycolmap.pair_id_to_image_pair(pair)
        matches = np.asarray(geometry.inlier_matches, dtype=np.int64)
        if a not in pixels or b not in pixels or len(matches) < _LEAST_MATCHES:
            continue
        some = matches[:: -(-len(matches) // _LOOKED_AT)]
        moved = np.array(
            [beyond_turning(pixels[a][some[:, 0]], pixels[b][some[:, 1]], f) for f in _FOCALS]
        )
        for number in (a, b):
            shared.setdefault(number, []).append((len(matches), moved))
    if not shared:
        return 0.0
    by_photo = np.stack([_quantile(each) for each in shared.values()])
    return float(np.median(by_photo, axis=0).min())


def beyond_turning(a: Float64Array, b: Float64Array, focal: float) -> float:
    """Median distance of matches from where a rotation puts them: the best of those that two
    matches give; up to half of the matches may be wrong.

    Args:
        a, b: (M, 2) from the middle of the photos, M at least 2.
        focal: in the same unit.
    """
    rays_a, rays_b = _rays(a, focal), _rays(b, focal)
    rng = np.random.default_rng(0)
    first, second = rng.integers(0, len(a), (2, _TRIALS))
    rotations = _frames(rays_b[first], rays_b[second]) @ np.swapaxes(
        _frames(rays_a[first], rays_a[second]), 1, 2
    )
    turned = np.einsum("tij,mj->tmi", rotations, rays_a)
    off = np.median(np.linalg.norm(turned - rays_b, axis=2), axis=1)
    return float(focal * off.min())


def _frames(first: Float64Array, second: Float64Array) -> Float64Array:
    """(T, 3, 3): axes along the middle of two rays and across both."""
    middle, apart = first + second, first - second
    axes = np.stack([middle, apart, np.cross(middle, apart)], axis=2)
    return np.asarray(axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-12))


def _quantile(shared: list[tuple[int, Float64Array]]) -> Float64Array:
    """Of values, (F,) each, weighted; (F,)."""
    weights = np.array([weight for weight, _ in shared], dtype=np.float64)
    values = np.stack([value for _, value in shared])
    order = np.argsort(values, axis=0)
    up_to = np.cumsum(weights[order], axis=0) / weights.sum()
    at = np.argmax(up_to >= _SHARE, axis=0)
    return np.asarray(np.take_along_axis(values, order, axis=0)[at, np.arange(values.shape[1])])


def _rays(pixels: Float64Array, focal: float) -> Float64Array:
    rays = np.column_stack([pixels, np.full(len(pixels), focal)])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
