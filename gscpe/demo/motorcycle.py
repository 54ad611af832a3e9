# SPDX-License-Identifier: Apache-2.0
"""The Middlebury Motorcycle pair: real photos with a true pose, and no download.

The pair ships inside scikit-image (``skimage.data.stereo_motorcycle``; Scharstein et al.,
GCPR 2014). The left photo with its true disparity makes an RGB-D photo; the right camera
stands a baseline beside the left one, along x, without rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float32Array, Float64Array, UInt8Array
from gscpe.geometry.camera import Camera

_FOCAL = 994.978
_BASELINE = 0.193001
# OpenCV's pixel coordinates: the top-left pixel centre is (0, 0).
_LEFT_CX, _RIGHT_CX, _CY = 311.193, 342.279, 254.877


@dataclass(frozen=True, eq=False)
class Motorcycle:
    """Both photos, (H, W, 3) uint8; the left one's z-depth, (H, W) float32 metres, 0 where
    unknown; the cameras; and the true pose of the right one, with the world in the left."""

    left: UInt8Array
    left_depth: Float32Array
    left_camera: Camera
    right: UInt8Array
    right_camera: Camera
    right_from_left: Float64Array


def load_motorcycle() -> Motorcycle:
    """Loads the pair from scikit-image."""
    import skimage.data

    left, right, disparity = skimage.data.stereo_motorcycle()
    height, width = left.shape[:2]
    known = np.isfinite(disparity)
    shift = np.where(known, disparity, 0.0) + (_RIGHT_CX - _LEFT_CX)
    depth = np.where(known, _FOCAL * _BASELINE / shift, 0.0).astype(np.float32)
    right_from_left = np.eye(4)
    right_from_left[0, 3] = -_BASELINE
    left_camera, right_camera = (
        Camera.pinhole(width, height, fx=_FOCAL, fy=_FOCAL, cx=cx + 0.5, cy=_CY + 0.5)
        for cx in (_LEFT_CX, _RIGHT_CX)
    )
    return Motorcycle(
        left=np.asarray(left, dtype=np.uint8),
        left_depth=depth,
        left_camera=left_camera,
        right=np.asarray(right, dtype=np.uint8),
        right_camera=right_camera,
        right_from_left=right_from_left,
    )
