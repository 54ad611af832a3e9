# SPDX-License-Identifier: Apache-2.0
"""The frame of a finished model: up is up, the scene is in the middle, and the unit is known or
not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.pose_error import camera_centres
from gscpe.geometry.similarity_transform import Similarity
from gscpe.geometry.up import common_up
from gscpe.reconstruction.depth_scale import scaled_by_depth
from gscpe.reconstruction.point_scale import scaled_by_points
from gscpe.reconstruction.scale import (
    ScaleSource,
    scaled_by_distance,
    scaled_like_gps,
    scaled_like_poses,
)


@dataclass(frozen=True)
class ModelFrame:
    """What is known of a model's frame.

    Attributes:
        metres_per_unit: None where the unit is not known.
        up: (0, 0, 1) where z points up; None where the cameras do not tell what is up, or the frame
            is that of known poses.
        gps_origin: latitude, longitude, altitude of the origin, the axes being east, north and up.
    """

    metres_per_unit: float | None
    up: tuple[float, float, float] | None
    gps_origin: tuple[float, float, float] | None = None


def settle_frame(
    model: Any,
    source: ScaleSource,
    gps: Mapping[str, tuple[float, float, float]],
    sizes: Mapping[str, tuple[int, int]],
) -> ModelFrame:
    """Moves a model, pycolmap.Reconstruction, into a frame that people can work with.

    With known poses, it is theirs. Else z points up, as far as the cameras tell; x follows the
    longer extent of their positions (GPS: east), and the origin is the median of the points.

    Args:
        model: to move.
        source: of the unit.
        gps: latitude, longitude and altitude of some photos.
        sizes: width and height of photos before they were shrunk.

    Raises:
        ReconstructionError: as :mod:`gscpe.reconstruction.scale`, ``point_scale``, ``depth_scale``.
    """
    poses = poses_of(model)
    if source.kind == "poses":
        assert source.poses is not None
        move_model(model, scaled_like_poses(poses, source.poses))
        return ModelFrame(1.0, None)
    up = common_up(np.stack(list(poses.values())))
    points = np.array([point.xyz for point in model.points3D.values()])
    move_model(model, levelled(np.stack(list(poses.values())), points, up))
    is_up = None if up is None else (0.0, 0.0, 1.0)
    poses = poses_of(model)
    if source.kind == "gps":
        moved, origin = scaled_like_gps(poses, gps)
        move_model(model, moved)
        return ModelFrame(1.0, is_up, origin)
    if source.kind == "distance":
        move_model(model, scaled_by_distance(poses, source))
        return ModelFrame(1.0, is_up)
    if source.kind == "points":
        assert source.lengths is not None
        move_model(model, scaled_by_points(model, source.lengths, sizes))
        return ModelFrame(1.0, is_up)
    if source.kind == "depth":
        assert source.depth is not None
        move_model(model, scaled_by_depth(model, source.depth, source.per_metre))
        return ModelFrame(1.0, is_up)
    return ModelFrame(None, is_up)


def levelled(
    cam_from_world: Float64Array, points: Float64Array, up: Float64Array | None
) -> Similarity:
    """The motion that puts ``up`` onto z (nowhere else, where it is None), the longer horizontal
    extent of the cameras onto x, and the median of the points, (N, 3), into the origin."""
    middle = np.median(points, axis=0) if len(points) else np.zeros(3)
    if up is None:
        return Similarity(1.0, np.eye(3), -middle)
    centres = camera_centres(cam_from_world)
    level = centres - centres.mean(axis=0)
    level -= np.outer(level @ up, up)
    along = np.linalg.eigh(level.T @ level)[1][:, -1]
    along -= (along @ up) * up
    if np.linalg.norm(along) < 1e-6:
        along = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    along /= np.linalg.norm(along)
    rotation = np.stack([along, np.cross(up, along), up])
    return Similarity(1.0, rotation, -rotation @ middle)


def poses_of(model: Any) -> dict[str, Float64Array]:
    """``cam_from_world``, (4, 4), of the photos of a pycolmap.Reconstruction, by sorted name."""
    poses = {}
    for image in sorted(model.images.values(), key=lambda image: str(image.name)):
        if image.has_pose:
            pose = np.eye(4)
            pose[:3] = image.cam_from_world().matrix()
            poses[str(image.name)] = pose
    return poses


def move_model(model: Any, moved: Similarity) -> None:
    """Moves a pycolmap.Reconstruction."""
    import pycolmap

    model.transform(
        pycolmap.Sim3d(moved.scale, pycolmap.Rotation3d(moved.rotation), moved.translation)
    )
