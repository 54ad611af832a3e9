# SPDX-License-Identifier: Apache-2.0
"""Pictures inside the page: data URIs, no larger together than they may be."""

from __future__ import annotations

import base64
import logging
from typing import Sequence

import cv2
import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.errors import OutputError

_log = logging.getLogger(__name__)

_QUALITIES = (70, 55, 40, 25, 10)


def data_uri(picture: UInt8Array, quality: int) -> str:
    """(H, W, 3) RGB or (H, W, 4) RGBA uint8 as a WebP image in a ``data:`` URI.

    Raises:
        OutputError: this OpenCV cannot write WebP.
    """
    order = [2, 1, 0, 3][: picture.shape[2]]
    pixels = np.ascontiguousarray(picture[:, :, order])
    encoded, data = cv2.imencode(".webp", pixels, [cv2.IMWRITE_WEBP_QUALITY, quality])
    if not encoded:
        raise OutputError("OpenCV cannot write WebP images; install an OpenCV with WebP support")
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def data_uris(pictures: Sequence[UInt8Array], quality: int, max_bytes: int) -> list[str]:
    """All pictures, in a lower quality where they would be more than ``max_bytes`` together."""
    for tried in (quality, *(q for q in _QUALITIES if q < quality)):
        uris = [data_uri(picture, tried) for picture in pictures]
        size = sum(map(len, uris))
        if size <= max_bytes:
            return uris
        _log.info("pictures of quality %d take %d bytes, %d are left", tried, size, max_bytes)
    _log.warning("the report exceeds its size limit: show fewer queries or smaller pictures")
    return uris
