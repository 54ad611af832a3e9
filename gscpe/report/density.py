"""The Gaussians from above, as a faint picture below the cameras."""

from __future__ import annotations

import cv2
import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.report.ground_plane import GroundPlane
from gscpe.scene import GaussianScene
from gscpe.scene.gaussians import SH_C0

_MOST_OPAQUE = 0.6


def density_picture(
    scene: GaussianScene,
    plane: GroundPlane,
    low: Float64Array,
    high: Float64Array,
    ceiling: float,
    width: int = 560,
) -> UInt8Array:
    """Means of the Gaussians, seen from above in their colours, (H, W, 4) uint8 RGBA.

    Alpha grows with the logarithm of their summed opacities.

    Args:
        scene: the splat.
        plane: of the picture.
        low, high: (2,) corners of the picture in the plane.
        ceiling: height along ``plane.up`` above which nothing is drawn.
        width: of the picture, pixels.
    """
    size = high - low
    height = max(1, round(width * size[1] / size[0]))
    flat = plane.flat(scene.means.astype(np.float64))
    cell = np.floor((flat - low) / size * (width, height)).astype(np.intp)
    inside = np.all((cell >= 0) & (cell < (width, height)), axis=1)
    inside &= scene.means @ plane.up <= ceiling
    index = (height - 1 - cell[inside, 1]) * width + cell[inside, 0]
    weight = scene.opacities[inside].astype(np.float64)
    colour = np.clip(0.5 + SH_C0 * scene.sh[inside, 0], 0.0, 1.0)

    def total(values: Float64Array) -> Float64Array:
        summed = np.bincount(index, values, width * height).astype(np.float64)  # int if empty
        return np.asarray(cv2.GaussianBlur(summed.reshape(height, width), (0, 0), 1.2))

    weights = total(weight)
    picture = np.zeros((height, width, 4))
    for channel in range(3):
        coloured = total(weight * colour[:, channel])
        picture[:, :, channel] = coloured / np.maximum(weights, 1e-9)
    seen = weights[weights > 1e-3]
    if len(seen):
        most = np.log1p(np.quantile(seen, 0.98))
        picture[:, :, 3] = _MOST_OPAQUE * np.clip(np.log1p(weights) / most, 0.0, 1.0)
    return np.asarray(np.rint(255.0 * picture), dtype=np.uint8)
