# SPDX-License-Identifier: Apache-2.0
"""Viewpoints for a splat of which nothing is known but its Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centres
from gscpe.geometry.spread import farthest_first
from gscpe.splats import GaussianScene
from gscpe.viewpoints.axes import main_axes
from gscpe.viewpoints.lattice import lattice_spacing
from gscpe.viewpoints.places import FACES, Place, PlaceSearch
from gscpe.viewpoints.settings import ViewpointSettings
from gscpe.viewpoints.space import Space
from gscpe.viewpoints.upright import axes_along, find_up


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """Where views of a splat are worth rendering; the first is from the best place.

    Attributes:
        cam_from_world: (N, 4, 4), world to camera, in the frame and unit of the splat; upright.
        camera: of all of them.
        up: (3,), the unit vector that is up.
        up_was_given: or else it was found.
    """

    cam_from_world: Float64Array
    camera: Camera
    up: Float64Array
    up_was_given: bool

    def __len__(self) -> int:
        return len(self.cam_from_world)

    def __repr__(self) -> str:
        how = "as given" if self.up_was_given else "as found"
        return f"Viewpoints({len(self)} views, up is {np.round(self.up, 2).tolist()}, {how})"


def find_viewpoints(
    scene: GaussianScene,
    settings: ViewpointSettings | None = None,
    backend: str = "auto",
    progress: bool = False,
) -> Viewpoints:
    """Poses inside the free space of a splat from which it looks as its photos did.

    Neither its unit nor what is up need be known. Free space is what an occupancy grid leaves
    empty; of its points, those are kept from which renders are sharp and surfaces thin
    (:class:`gscpe.viewpoints.quality.ViewQuality`).

    Raises:
        MapError: there is no free space from which surfaces are seen.
        RenderError, MissingDependencyError: as :class:`gscpe.Renderer`.
    """
    settings = settings or ViewpointSettings()
    axes = main_axes(scene)
    given = None if settings.up is None else np.asarray(settings.up) / np.linalg.norm(settings.up)
    if given is not None:
        axes = axes_along(axes, given)
    space = Space.of(scene, axes)
    search = PlaceSearch(scene, space, settings, backend, progress)
    seeds = search.spread_out()
    up = find_up(scene, space, seeds) if given is None else given
    poses = search.usable(_views(search.good(up), space, up, settings))
    poses[:, :3, 3] -= poses[:, :3, :3] @ scene.origin
    return Viewpoints(poses, settings.camera, up, given is not None)


def _views(
    places: list[Place], space: Space, up: Float64Array, settings: ViewpointSettings
) -> Float64Array:
    """World-to-camera poses, (N, 4, 4), relative to the scene's origin; where there are more than
    are wanted, those that are far from each other."""
    limit = min(place.best for place in places)
    views = [
        _looking(space.axes @ place.point, forward, up)
        for place in places
        for (axis, sign), score in zip(FACES, place.scores, strict=True)
        if score >= limit
        for forward in _directions(sign * space.axes[:, axis], up, settings)
    ]
    poses = np.array(views)
    if len(poses) <= settings.most:
        return poses
    # A step of yaw is as far as a step of place.
    turn = 2.0 * np.sin(0.5 * np.deg2rad(settings.yaw_step))
    steps = camera_centres(poses) / lattice_spacing(space, settings)
    return poses[farthest_first(np.hstack([steps, poses[:, 2, :3] / turn]), settings.most)]


def _directions(
    level: Float64Array, up: Float64Array, settings: ViewpointSettings
) -> list[Float64Array]:
    """Where upright cameras look within the 90 degrees around a level main axis."""
    half = int(np.floor(45.0 / settings.yaw_step))
    yaws = settings.yaw_step * np.arange(-half, half + 1)
    return [_turned(level, up, float(yaw), settings.pitch_down) for yaw in yaws]


def _turned(level: Float64Array, up: Float64Array, yaw: float, down: float) -> Float64Array:
    """A level direction turned about up, then lowered; degrees."""
    yaw, down = np.deg2rad(yaw), np.deg2rad(down)
    turned = np.cos(yaw) * level + np.sin(yaw) * np.cross(up, level)
    return np.asarray(np.cos(down) * turned - np.sin(down) * up)


def _looking(centre: Float64Array, forward: Float64Array, up: Float64Array) -> Float64Array:
    """World to camera, (4, 4), of an upright camera."""
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ centre
    return pose
