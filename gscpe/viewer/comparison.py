# SPDX-License-Identifier: Apache-2.0
"""A photo laid over the map: over a render from its pose, since browsers cannot blend a
transparent picture with the Gaussians behind it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.render import RenderedView, Renderer
from gscpe.render.pictures import difference_picture
from gscpe.scene import to_uint8
from gscpe.viewer.cameras import ShownCamera
from gscpe.viewer.photos import Photos

_WIDTH = 960


@dataclass(frozen=True, eq=False)
class Comparison:
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
        seen = self.view.opacity > 0.5
        gain, bias = 1.0, 0.0
        if np.count_nonzero(seen) > 1:
            render, photo = self.view.rgb[seen], self.photo[seen] / np.float32(255.0)
            gain = float(np.clip(photo.std() / max(float(render.std()), 1e-3), 0.5, 2.0))
            bias = float(photo.mean() - gain * render.mean())
        return difference_picture(self.photo, self.view, gain, bias)


def compare(shown: ShownCamera, photos: Photos, renderer: Renderer) -> Comparison | None:
    """Photo and render; None where there is no photo.

    Raises:
        RenderError: rendering failed.
    """
    photo = photos.picture(shown, _WIDTH)
    if photo is None:
        return None
    camera = shown.camera.without_distortion().resized(photo.shape[1], photo.shape[0])
    return Comparison(shown, photo, renderer.render(camera, shown.cam_from_map))
