# SPDX-License-Identifier: Apache-2.0
"""The camera's motion between frames, from the trajectory of another system."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.datasets.tum import Trajectory
from gscpe.errors import PoseError, SettingsError
from gscpe.geometry import se3
from gscpe.poses import read_pose_file
from gscpe.tracking import Motion

LONGEST_GAP = 0.5
"""Seconds from a frame to the pose before and after it, at most."""


class Odometry:
    """Motions between the times of frames, for :meth:`gscpe.Tracker.track`; only these count, so
    the trajectory may be in any frame.

    Args:
        trajectory: of a body, in seconds and world units.
        cam_from_body: (4, 4); None: the body is the camera.
        translation_sigma, rotation_sigma: of a motion; see :class:`gscpe.Motion`.

    Raises:
        PoseError: ``cam_from_body`` is not a rigid transform.
        SettingsError: a sigma is not positive.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        cam_from_body: Float64Array | None = None,
        translation_sigma: float = Motion.translation_sigma,
        rotation_sigma: float = Motion.rotation_sigma,
    ) -> None:
        if not all(0 < sigma < np.inf for sigma in (translation_sigma, rotation_sigma)):
            raise SettingsError(
                "the standard deviations of odometry must be positive, not "
                f"{translation_sigma:g} and {rotation_sigma:g}"
            )
        self._trajectory = trajectory
        self._cam_from_body = se3.check_transform(
            np.eye(4) if cam_from_body is None else cam_from_body, "cam_from_body"
        )
        self._sigmas = translation_sigma, rotation_sigma

    @property
    def span(self) -> tuple[float, float]:
        """Its first and last time."""
        return float(self._trajectory.stamps[0]), float(self._trajectory.stamps[-1])

    def motion(self, before: float, now: float) -> Motion | None:
        """From one time to another; None where the trajectory has a gap.

        Between its poses, it is interpolated: positions linearly, rotations along the shortest way
        (slerp).
        """
        world_from_before = self._trajectory.at(before, LONGEST_GAP)
        world_from_now = self._trajectory.at(now, LONGEST_GAP)
        if world_from_before is None or world_from_now is None:
            return None
        now_from_before = se3.inverse(world_from_now) @ world_from_before
        moved = self._cam_from_body @ now_from_before @ se3.inverse(self._cam_from_body)
        return Motion(moved, *self._sigmas)


def read_odometry(
    path: str | Path,
    cam_from_body: Float64Array | None = None,
    translation_sigma: float = Motion.translation_sigma,
    rotation_sigma: float = Motion.rotation_sigma,
) -> Odometry:
    """From a file in TUM's form, ``time tx ty tz qx qy qz qw``, body to world.

    Raises:
        PoseError: the file cannot be read, has another form, or has fewer than two poses.
        SettingsError: a sigma is not positive.
    """
    poses = read_pose_file(path, "tum").poses
    if len(poses) < 2:
        raise PoseError(f"{path} has {len(poses)} poses; motions need at least two")
    trajectory = Trajectory.of(poses)
    return Odometry(trajectory, cam_from_body, translation_sigma, rotation_sigma)
