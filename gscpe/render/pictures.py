# SPDX-License-Identifier: Apache-2.0
"""Renders as pictures for people: their depth, and how well they fit a photo."""

from __future__ import annotations

import cv2
import numpy as np

from gscpe.arrays import Float32Array, UInt8Array
from gscpe.render.view import RenderedView
from gscpe.scene import to_uint8

UNSEEN = (0, 0, 40)
"""The dark blue of a difference where the map shows nothing."""


def difference_picture(
    photo: UInt8Array, view: RenderedView, gain: float = 1.0, bias: float = 0.0, boost: float = 4.0
) -> UInt8Array:
    """``boost * |photo - (gain * render + bias)|``, (H, W, 3) uint8, brighter is worse.

    UNSEEN where the map shows nothing: there is nothing to compare.
    """
    difference = np.abs(photo.astype(np.float32) / 255.0 - (gain * view.rgb + bias))
    picture = to_uint8(np.asarray(boost * difference, dtype=np.float32))
    picture[view.opacity < 0.5] = UNSEEN
    return picture


def depth_picture(depth: Float32Array) -> UInt8Array:
    """z-depth, (H, W), as colours, (H, W, 3) uint8: near is bright, unknown black."""
    known = depth > 0
    if not np.any(known):
        return np.zeros((*depth.shape, 3), dtype=np.uint8)
    near, far = np.percentile(depth[known], [1, 99])
    nearness = np.clip((far - depth) / max(far - near, 1e-9), 0.0, 1.0)
    coloured = cv2.applyColorMap(to_uint8(nearness.astype(np.float32)), cv2.COLORMAP_INFERNO)
    picture = np.ascontiguousarray(coloured[:, :, ::-1])
    picture[~known] = 0
    return np.asarray(picture, dtype=np.uint8)
