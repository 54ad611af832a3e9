# SPDX-License-Identifier: Apache-2.0
"""Renders as pictures for people: depth, how well they fit a photo, several side by side."""

from __future__ import annotations

from typing import Sequence

import cv2
import numpy as np

from gscpe.arrays import Float32Array, UInt8Array
from gscpe.photos import to_uint8
from gscpe.render.view import RenderedView

UNSEEN = (0, 0, 40)
"""The dark blue of a difference where the map shows nothing."""

Panel = tuple[str, UInt8Array, str]
"""Title above, picture, lines of a caption at its lower edge or ""."""

_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


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


def fit_light(photo: UInt8Array, view: RenderedView) -> tuple[float, float]:
    """Gain and bias by which the render is nearest to the photo, (H, W, 3) uint8, in least
    squares; 1 and 0 where the map shows nothing."""
    seen = view.opacity > 0.5
    if np.count_nonzero(seen) < 2:
        return 1.0, 0.0
    a, b = view.rgb[seen].ravel(), photo[seen].ravel() / np.float32(255.0)
    spread = float(np.var(a))
    gain = float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 1e-6 else 1.0
    gain = min(max(gain, 0.2), 5.0)
    return gain, float(b.mean() - gain * a.mean())


def montage(rows: Sequence[Sequence[Panel]], width: int = 480) -> UInt8Array:
    """Titled pictures in rows of equal length, each shrunk to ``width`` pixels."""
    return np.concatenate([np.concatenate([_panel(*p, width) for p in row], 1) for row in rows])


def _panel(title: str, picture: UInt8Array, caption: str, width: int) -> UInt8Array:
    height = round(picture.shape[0] * width / picture.shape[1])
    small = np.ascontiguousarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))
    lines = caption.splitlines()
    if lines:
        strip = small[height - 8 - 18 * len(lines) :]
        strip[:] = (0.3 * strip).astype(np.uint8)
    for number, line in enumerate(reversed(lines)):
        at = (8, height - 9 - 18 * number)
        cv2.putText(small, line, at, _FONT, 0.44, _WHITE, 1, cv2.LINE_AA)
    bar = np.full((26, width, 3), 255, dtype=np.uint8)
    cv2.putText(bar, title, (6, 18), _FONT, 0.46, _BLACK, 1, cv2.LINE_AA)
    return np.concatenate([bar, np.asarray(small, dtype=np.uint8)])
