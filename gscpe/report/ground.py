# SPDX-License-Identifier: Apache-2.0
"""The scene from above: in which plane, and its Gaussians as a faint picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.geometry.up import common_up
from gscpe.splats import GaussianScene
from gscpe.splats.gaussians import SH_C0

_MOST_OPAQUE = 0.6


@dataclass(frozen=True, eq=False)
class GroundPlane:
    """Directions of a picture that is seen from above.

    Attributes:
        axes: (2, 3) unit vectors in the world: to the right, and to the top of the picture.
        up: (3,) unit vector towards the eye, ``cross(*axes)``.
        why: how it was chosen, for people.
    """

    axes: Float64Array
    up: Float64Array
    why: str

    def flat(self, points: Float64Array) -> Float64Array:
        """World points, (..., 3), as (..., 2)."""
        return np.asarray(points @ self.axes.T)


def choose_ground_plane(cam_from_world: Float64Array, centres: Float64Array) -> GroundPlane:
    """The plane of a picture from above.

    Where the cameras have no common up, two principal axes of the positions are taken.

    Args:
        cam_from_world: (N, 4, 4) of the reference photos; N may be 0.
        centres: (M, 3) of all cameras that will be drawn, M > 0.
    """
    spread = _principal_axes(centres)
    up = common_up(cam_from_world)
    if up is not None:
        why = (
            "Up is the direction most at right angles to the image rows of the reference photos; "
            "the longer extent of the camera positions is horizontal."
        )
    else:
        up = spread[2]
        why = (
            "The reference photos have no common up direction: the picture shows the two "
            "principal axes of the camera positions."
        )
    level = centres - np.outer(centres @ up, up)
    across = _principal_axes(level)[0]
    across -= (across @ up) * up
    if np.linalg.norm(across) < 1e-6:  # all cameras stand above each other
        across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    return GroundPlane(np.stack([across, np.cross(up, across)]), up, why)


def _principal_axes(points: Float64Array) -> Float64Array:
    """(3, 3), rows by falling variance."""
    centred = points - points.mean(axis=0)
    return np.asarray(np.linalg.eigh(centred.T @ centred)[1][:, ::-1].T)


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
