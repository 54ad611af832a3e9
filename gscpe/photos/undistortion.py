# SPDX-License-Identifier: Apache-2.0
"""Pictures of a distorted camera as a pinhole camera sees them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array
from gscpe.geometry.camera import Camera
from gscpe.geometry.lens import image_of_directions
from gscpe.geometry.projection import pixel_centres, unproject


@dataclass(frozen=True, eq=False)
class Undistortion:
    """Where each pixel of the pinhole camera's picture comes from; made once for many pictures.

    Attributes:
        camera: with distortion, or a fisheye.
        pinhole: of the same size.
        map_u, map_v: (H, W) pixels of the camera's picture, as OpenCV counts them.
        inside: (H, W), whether the camera's picture has that pixel.
    """

    camera: Camera
    pinhole: Camera
    map_u: Float32Array
    map_v: Float32Array
    inside: BoolArray

    @classmethod
    def of(cls, camera: Camera) -> Undistortion:
        """Of a camera that is no pinhole."""
        pinhole = camera.without_distortion()
        map_u, map_v, imaged = _source_pixels(camera, pinhole)
        imaged &= (map_u >= 0) & (map_u <= camera.width - 1)
        imaged &= (map_v >= 0) & (map_v <= camera.height - 1)
        return cls(camera, pinhole, map_u, map_v, imaged)

    def image(self, image: UInt8Array) -> UInt8Array:
        """A picture of the camera, (H, W) or (H, W, C), as the pinhole sees it."""
        # OpenCV's cubic kernel shifts by up to 0.05 px with the phase; this one by up to 0.03.
        lanczos, replicate = cv2.INTER_LANCZOS4, cv2.BORDER_REPLICATE
        warped = cv2.remap(image, self.map_u, self.map_v, lanczos, borderMode=replicate)
        return np.asarray(warped, dtype=np.uint8)

    def valid(self, seen: BoolArray | None) -> BoolArray:
        """Where the pinhole's picture shows what the camera saw, (H, W), if only ``seen`` counts
        of its picture."""
        if seen is None:
            return self.inside
        share = cv2.remap(seen.astype(np.float32), self.map_u, self.map_v, cv2.INTER_LINEAR)
        return np.asarray(self.inside & (share > 0.99))


def _source_pixels(camera: Camera, pinhole: Camera) -> tuple[Float32Array, Float32Array, BoolArray]:
    """Where each pixel of the pinhole's photo is in the camera's, OpenCV's pixels, and whether
    the lens images it at all; (H, W) each."""
    size = (pinhole.height, pinhole.width)
    if not camera.fisheye:
        map_u, map_v = cv2.initUndistortRectifyMap(
            *(camera.opencv_matrix(), np.asarray(camera.distortion), np.eye(3)),
            *(pinhole.opencv_matrix(), size[::-1], cv2.CV_32FC1),
        )
        return np.asarray(map_u), np.asarray(map_v), np.ones(size, dtype=bool)
    pixels = pixel_centres(pinhole).reshape(-1, 2)
    directions = unproject(pinhole, pixels, np.ones(len(pixels)))
    images, imaged = image_of_directions(camera, directions)
    map_u, map_v = (images.T - 0.5).astype(np.float32).reshape(2, *size)
    return map_u, map_v, imaged.reshape(size)
