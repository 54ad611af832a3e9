# SPDX-License-Identifier: Apache-2.0
"""Trajectories in the TUM form: ``stamp tx ty tz qx qy qz qw``, body to world."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.datasets.files import read_text
from gscpe.errors import DatasetError, PoseError
from gscpe.geometry.se3 import from_rotation_translation, inverse
from gscpe.poses.tum import parse_tum

LONGEST_GAP_SECONDS = 0.1
# Stamps are written with six digits.
_SAME_SECONDS = 1e-6


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses over time.

    Attributes:
        stamps: (N,) float64, seconds, increasing.
        world_from_body: (N, 4, 4) float64.
    """

    stamps: Float64Array
    world_from_body: Float64Array

    @classmethod
    def of(cls, poses: Mapping[str, Float64Array]) -> Trajectory:
        """Of poses ``body_from_world``, (4, 4), by time, as :func:`parse_tum` has them."""
        stamps, first = np.unique([float(stamp) for stamp in poses], return_index=True)
        return cls(stamps, np.stack([inverse(pose) for pose in poses.values()])[first])

    def at(self, stamp: float, longest_gap: float = LONGEST_GAP_SECONDS) -> Float64Array | None:
        """``world_from_body``, (4, 4), at a time: slerp and linear between the two neighbours.

        None where one of them is further away than ``longest_gap`` seconds, or missing.
        """
        if not np.isfinite(stamp):
            return None
        after = int(np.searchsorted(self.stamps, stamp))
        for i in (after - 1, after):
            if 0 <= i < len(self.stamps) and abs(self.stamps[i] - stamp) <= _SAME_SECONDS:
                return np.array(self.world_from_body[i])
        if not 0 < after < len(self.stamps):
            return None
        before = after - 1
        if max(stamp - self.stamps[before], self.stamps[after] - stamp) > longest_gap:
            return None
        from scipy.spatial.transform import Rotation, Slerp

        pair = self.world_from_body[before : after + 1]
        times = self.stamps[before : after + 1]
        rotation = Slerp(times, Rotation.from_matrix(pair[:, :3, :3]))(stamp).as_matrix()
        share = (stamp - times[0]) / (times[1] - times[0])
        return from_rotation_translation(
            rotation, (1.0 - share) * pair[0, :3, 3] + share * pair[1, :3, 3]
        )


def read_trajectory(path: Path, source: str) -> Trajectory:
    """The poses of a TUM file, sorted by time.

    Raises:
        DatasetError: the file is missing or empty, or a line has another form.
    """
    try:
        poses = parse_tum(read_text(path, source), str(path))
    except PoseError as error:
        raise DatasetError(str(error)) from None
    if not poses:
        raise DatasetError(f"{path} holds no poses; it comes from {source}")
    trajectory = Trajectory.of(poses)
    if not all(np.all(np.abs(v) < 1e15) for v in (trajectory.stamps, trajectory.world_from_body)):
        raise DatasetError(f"{path}: a stamp or a position is not a possible number")
    return trajectory
