# SPDX-License-Identifier: Apache-2.0
"""A photo laid over the map: over a render from its pose, since browsers cannot blend a
transparent picture with the Gaussians behind it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.photos import to_uint8
from gscpe.render import RenderedView, Renderer
from gscpe.render.pictures import difference_picture, fit_light
from gscpe.viewer.cameras import ShownCamera
from gscpe.viewer.photos import Photos

_WIDTH = 960


@dataclass(frozen=True, eq=False)
class PhotoOverMap:
    """Photo and render of a camera.

    Attributes:
        shown: the camera.
        photo: (H, W, 3) uint8, without lens distortion.
        view: the map at the camera's pose, of the same size.
    """

    shown: ShownCamera
    photo: UInt8Array
    view: RenderedView

    def blend(self, opacity: float) -> UInt8Array:
        """The photo over the render, (H, W, 3) uint8; 0 is the render, 1 the photo."""
        render = to_uint8(self.view.rgb)
        mixed = cv2.addWeighted(self.photo, opacity, render, 1.0 - opacity, 0.0)
        return np.asarray(mixed, dtype=np.uint8)

    def difference(self) -> UInt8Array:
        """See :func:`gscpe.render.pictures.difference_picture`; light is made alike."""
        gain, bias = fit_light(self.photo, self.view)
        return difference_picture(self.photo, self.view, gain, bias)


def photo_over_map(shown: ShownCamera, photos: Photos, renderer: Renderer) -> PhotoOverMap | None:
    """Photo and render; None where there is no photo.

    Raises:
        RenderError: rendering failed.
    """
    photo = photos.picture(shown, _WIDTH)
    if photo is None:
        return None
    camera = shown.camera.without_distortion().resized(photo.shape[1], photo.shape[0])
    return PhotoOverMap(shown, photo, renderer.render(camera, shown.cam_from_map))
