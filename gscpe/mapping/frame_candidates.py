# SPDX-License-Identifier: Apache-2.0
"""Frames that splats are found in, when they are not in that of their model: what trainers and
editors do to a scene before they export it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.pose_error import camera_centres
from gscpe.geometry.similarity_transform import Similarity
from gscpe.scene import References

_COLMAP_TO_NERFSTUDIO = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""What nerfstudio does to the axes of a COLMAP model before all else (``applied_transform``)."""


@dataclass(frozen=True, eq=False)
class FrameCandidate:
    """A guess.

    Attributes:
        name: what was done to the splat, as in "the splat was ...".
        splat_from_model: takes the model's frame to the splat's.
    """

    name: str
    splat_from_model: Similarity


def frame_candidates(references: References) -> tuple[FrameCandidate, ...]:
    """Turns by a right angle or two, and nerfstudio's normalization, of which the references tell
    enough to come near; they are to be tried against the photos."""
    swapped = Similarity(1.0, _COLMAP_TO_NERFSTUDIO, np.zeros(3))
    normalized = "oriented, centred and scaled by nerfstudio"
    return (
        *(
            FrameCandidate(f"turned by {degrees} degrees about {name}", _turn(axis, degrees))
            for axis, name, degrees in (
                (0, "x (y and z negated)", 180),
                (2, "z (x and y negated)", 180),
                (1, "y (x and z negated)", 180),
                (0, "x", 90),
                (0, "x", -90),
            )
        ),
        FrameCandidate(normalized, nerfstudio_normalization(references, swapped)),
        FrameCandidate(normalized, nerfstudio_normalization(references, Similarity.identity())),
        FrameCandidate("turned to nerfstudio's axes", swapped),
    )


def nerfstudio_normalization(references: References, axes: Similarity) -> Similarity:
    """What nerfstudio's data parsers do with their default settings (``orientation_method="up"``,
    ``center_method="poses"``, ``auto_scale_poses``): the mean of the cameras' up vectors becomes z,
    the mean of their centres the origin, and their largest coordinate 1.

    Args:
        references: with respect to the model.
        axes: what was done to the model's axes before.
    """
    poses = axes.cam_from_b(references.cam_from_world)
    centres = camera_centres(poses)
    up = -poses[:, 1, :3].mean(axis=0)  # OpenCV's y axis points down
    length = float(np.linalg.norm(up))
    rotation = _least_turn(up / length, np.array([0.0, 0.0, 1.0])) if length > 1e-9 else np.eye(3)
    centred = (centres - centres.mean(axis=0)) @ rotation.T
    largest = float(np.abs(centred).max())
    scale = 1.0 / largest if largest > 1e-12 else 1.0
    return Similarity(scale, rotation, -scale * rotation @ centres.mean(axis=0)) @ axes


def _turn(axis: int, degrees: float) -> Similarity:
    from scipy.spatial.transform import Rotation  # takes longer to import than all else

    turn = Rotation.from_euler("xyz"[axis], degrees, degrees=True)
    return Similarity(1.0, np.asarray(turn.as_matrix()), np.zeros(3))


def _least_turn(a: Float64Array, b: Float64Array) -> Float64Array:
    """The rotation of unit vector a to unit vector b about their common normal."""
    from scipy.spatial.transform import Rotation

    axis, cosine = np.cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        axis, sine = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))]), 0.0
    axis = axis / np.linalg.norm(axis)
    return np.asarray(Rotation.from_rotvec(np.arctan2(sine, cosine) * axis).as_matrix())
