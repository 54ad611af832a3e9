"""Pictures that show how well a render fits its photo."""

from __future__ import annotations

from typing import Sequence

import cv2
import numpy as np

from gscpe.arrays import Float32Array, UInt8Array
from gscpe.render import RenderedView
from gscpe.scene import to_uint8


def difference_picture(
    photo: UInt8Array, view: RenderedView, gain: float = 1.0, bias: float = 0.0, boost: float = 4.0
) -> UInt8Array:
    """``boost * |photo - (gain * render + bias)|``, (H, W, 3) uint8, brighter is worse.

    Dark blue where the map shows nothing: there is nothing to compare.
    """
    difference = np.abs(photo.astype(np.float32) / 255.0 - (gain * view.rgb + bias))
    picture = to_uint8(np.asarray(boost * difference, dtype=np.float32))
    picture[view.opacity < 0.5] = (0, 0, 40)
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


def montage(rows: Sequence[Sequence[tuple[str, UInt8Array]]], width: int = 480) -> UInt8Array:
    """Titled pictures in rows of equal length, each shrunk to ``width`` pixels."""
    return np.concatenate([np.concatenate([_titled(*p, width) for p in row], 1) for row in rows])


def _titled(title: str, picture: UInt8Array, width: int) -> UInt8Array:
    height = round(picture.shape[0] * width / picture.shape[1])
    small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    bar = np.full((26, width, 3), 255, dtype=np.uint8)
    font = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(bar, title, (6, 18), font, 0.48, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate([bar, np.asarray(small, dtype=np.uint8)])
