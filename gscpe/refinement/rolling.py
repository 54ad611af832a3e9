# SPDX-License-Identifier: Apache-2.0
"""The pose of a photo whose rows do not all agree on one.

Most cameras expose row after row, some 20 ms from the first to the last (rolling shutter), and in
the hand they move by pixels meanwhile. Maps are bent a little, too. One pose for the whole photo
is then a mean of many, and the alignment's is weighted by gradients: it is the pose of the rows
that have the texture. True poses, from structure from motion, are means over the picture.

So after the alignment a second motion is sought, which grows from the first row to the last,

    residual = J (motion + row second) + light,    row from -1/2 to 1/2,

and the pose becomes that which moves the picture most like both together, wherever the texture
is. Pixels tell little of the second motion. So it is held near zero, as by a Gaussian prior, and
the pixels of a block, which share the errors of the map there, count as one. (In video, the frames
around determine such a motion: Hedborg et al., "Rolling shutter bundle adjustment", CVPR 2012.)
Measured: docs/benchmarks.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float32Array, Float64Array
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.projection import pose_jacobian
from gscpe.refinement.lucas_kanade import Alignment
from gscpe.refinement.products import weighted_squares
from gscpe.refinement.pyramid import ImageLevel
from gscpe.refinement.robust import tukey_weights
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.template import Template, residuals_of
from gscpe.refinement.uncertainty import moved_by_camera

_KNOWN = 1e-9
"""Share of the largest eigenvalue, below which a direction is not determined."""
_CERTAIN = 1e-9, 1e9
"""Pixels below and above which a prior's deviation changes nothing more, but its square may be no
number."""
_SAMPLES = 5_000
"""About so many points are enough to compare two motions of the picture."""


@dataclass(frozen=True, eq=False)
class PoseOfAllRows:
    """A mean over the picture.

    Attributes:
        photo_from_anchor: (4, 4).
        by_camera: (6, 5), as :class:`PoseUncertainty`'s.
    """

    photo_from_anchor: Float64Array
    by_camera: Float64Array


def pose_of_all_rows(
    template: Template,
    photo: ImageLevel,
    alignment: Alignment,
    solver: LucasKanadeSettings,
    rolling_pixels: float,
    blocks: int,
) -> PoseOfAllRows:
    """What comes of an alignment with a second motion.

    Args:
        template, photo, solver: that were aligned, at full size.
        alignment: what came of it.
        rolling_pixels: standard deviation of the second motion, from the first row to the last,
            root mean square over the picture; above 0.
        blocks: in a row of the photo; the pixels of each count as one observation.
    """
    pose = alignment.photo_from_anchor
    residuals, usable = residuals_of(template, photo, pose, alignment.gain, alignment.bias)
    weights = usable.astype(np.float32)
    if solver.robust:
        weights *= tukey_weights(residuals, alignment.residual)
    place = _place_among_rows(template, photo.camera)
    # How residuals follow the motion, the second one, gain and bias; they themselves; and how they
    # follow the camera.
    rows = np.empty((20, len(residuals)), dtype=np.float32)
    np.multiply(template.jacobian.T, np.float32(alignment.gain), out=rows[:6])
    np.multiply(rows[:6], place, out=rows[6:12])
    rows[12], rows[13], rows[14] = template.intensities, 1.0, residuals
    rows[15:] = moved_by_camera(template, alignment.gain)
    products = weighted_squares(rows, weights)
    unknowns = 14 if solver.gain_and_bias else 12
    hessian, right = products[:unknowns, :unknowns], products[:unknowns, 14:]
    observations = blocks * blocks * photo.camera.height / photo.camera.width
    variance = alignment.residual**2 * float(weights.sum()) / observations
    expected = float(np.clip(rolling_pixels, *_CERTAIN))
    hessian[6:12, 6:12] += variance / expected**2 * template.motion
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-12))[:, None]
    # Along stripes, what nothing determines is left as it is.
    step = np.linalg.lstsq(hessian / (scale * scale.T), right / scale, rcond=_KNOWN)[0] / scale
    like_second = _motion_like_second(template, photo.camera, place, weights)
    motion = step[:6] + like_second @ step[6:12]
    by_camera = -se3.adjoint(pose) @ motion[:, 1:]
    return PoseOfAllRows(pose @ se3.exp(-motion[:, 0]), by_camera)


def _place_among_rows(template: Template, camera: Camera) -> Float32Array:
    """Of each point, (N,): from -1/2 in the first row to 1/2 in the last."""
    slope = template.points[1] / template.points[2]
    first = np.float32(camera.cy / camera.height - 0.5)
    return np.asarray(slope * np.float32(camera.fy / camera.height) + first)


def _motion_like_second(
    template: Template, camera: Camera, place: Float32Array, weights: Float32Array
) -> Float64Array:
    """(6, 6), from a second motion to that of the whole camera which moves the picture most like
    it, wherever the photo shows the map."""
    step = max(1, len(place) // _SAMPLES)
    points = template.points[:, ::step].T.astype(np.float64)
    by_motion = pose_jacobian(camera, points).transpose(2, 1, 0).reshape(6, -1)
    weighted = by_motion * np.tile(weights[::step], 2)
    by_second = by_motion * np.tile(place[::step], 2)
    like = np.linalg.lstsq(weighted @ by_motion.T, weighted @ by_second.T, rcond=_KNOWN)[0]
    return np.asarray(like)
