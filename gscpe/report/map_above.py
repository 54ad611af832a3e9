# SPDX-License-Identifier: Apache-2.0
"""A map and its references from above, as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from gscpe.geometry.pose_error import camera_centres
from gscpe.geometry.spread import thinned
from gscpe.report.ground import choose_ground_plane
from gscpe.report.seen_from_above import (
    WIDTH,
    camera_layer,
    density_layer,
    drawing_of,
    frame_around,
    scale_bar,
)
from gscpe.scene import Map
from gscpe.scene.map_frame import typical_depth

_REACH = 1.5
"""Times the typical depth: what cameras look at is shown in a map on its own."""


def map_from_above(map_: Map, marks: int = 400) -> dict[str, Any]:
    """A map and its reference photos, for pages that add cameras of their own; plain data.

    Args:
        map_: references and Gaussians.
        marks: references that are drawn at most.

    Returns:
        ``drawing``: text of an ``svg`` element; ``width`` and ``height`` of its view box;
        ``pixel_from_world``: (2, 4), from homogeneous world points to its pixels;
        ``metres_per_unit``, or None; ``caption``.
    """
    poses = map_.references.cam_from_world.reshape(-1, 4, 4)
    means = map_.scene.means.astype(np.float64)
    some = means[:: max(1, len(means) // 1000)]
    centres = camera_centres(poses) if len(poses) else some
    plane = choose_ground_plane(poses, centres)
    reach = _REACH * typical_depth(map_.scene, map_.references)
    frame = frame_around(plane.flat(centres), plane.flat(means), reach)
    ceiling = float(np.max(centres @ plane.up))
    layers = [density_layer(map_, plane, frame, ceiling)]
    drawn = thinned(list(poses), marks)
    if drawn:
        at = frame.at(plane.flat(camera_centres(drawn)))
        ahead = plane.flat(np.array([pose[2, :3] for pose in drawn])) * (1.0, -1.0)
        layers.append(camera_layer(at, ahead, "reference"))
    if map_.metres_per_unit is not None:  # a map's frame is in metres then
        layers.append(scale_bar(frame, 1.0))
    # x_map = scale * (x_world - origin)
    flat = map_.frame.scale * np.column_stack([plane.axes, -plane.axes @ map_.frame.origin])
    flat[:, 3] -= (frame.low[0], frame.high[1])
    return {
        "drawing": str(drawing_of(layers, frame, f"The map with {map_.references.count_text()}.")),
        "width": WIDTH,
        "height": frame.height,
        "pixel_from_world": (np.diag([frame.scale, -frame.scale]) @ flat).tolist(),
        "metres_per_unit": map_.metres_per_unit,
        "caption": plane.why,
    }
