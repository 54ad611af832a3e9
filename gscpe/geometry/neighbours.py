# SPDX-License-Identifier: Apache-2.0
"""Cameras that may see the same, by their poses alone."""

from __future__ import annotations

from typing import Iterable

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.pose_error import camera_centres

_RIGHT_ANGLE = 0.5 * np.pi


def pairs_by_pose(cam_from_world: Float64Array, ranks: Iterable[int]) -> list[tuple[int, int]]:
    """Pairs of cameras, first below second, that may see the same: each with those nearest to it
    by distance of the centres (in units of the cameras' median spread) and angle between the
    viewing axes (in right angles), of those less than a right angle apart.

    Args:
        cam_from_world: (N, 4, 4).
        ranks: which of the nearest, from 0; for 0, 1, 3 the nearest, the second and the fourth.
    """
    centres = camera_centres(cam_from_world)
    spread = np.median(np.linalg.norm(centres - np.median(centres, axis=0), axis=1))
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) / max(float(spread), 1e-12)
    axes = cam_from_world[:, 2, :3]
    angles = np.arccos(np.clip(axes @ axes.T, -1.0, 1.0)) / _RIGHT_ANGLE
    cost = np.where(angles < 1.0, apart + angles, np.inf)
    np.fill_diagonal(cost, np.inf)
    wanted = np.array(sorted(set(ranks)), dtype=np.int64)
    wanted = wanted[wanted < len(cost)]
    pairs = set()
    for first, row in enumerate(cost):
        for second in np.argsort(row, kind="stable")[wanted]:
            if np.isfinite(row[second]):
                pairs.add((min(first, int(second)), max(first, int(second))))
    return sorted(pairs)
