# SPDX-License-Identifier: Apache-2.0
"""Viewpoints for a splat of which nothing is known but its Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import MapError
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centres
from gscpe.geometry.spread import farthest_first
from gscpe.splats import GaussianScene
from gscpe.viewpoints.axes import main_axes
from gscpe.viewpoints.lattice import lattice_spacing
from gscpe.viewpoints.places import FIFTH, NOTHING, OUT_OF_SIGHT, PlaceSearch
from gscpe.viewpoints.settings import ViewpointSettings
from gscpe.viewpoints.space import Space
from gscpe.viewpoints.upright import axes_along, find_up
from gscpe.viewpoints.views import find_pitch, views_of


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
    *,
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
    places = search.good(up)
    down = settings.pitch_down
    if down is None:
        down = find_pitch(places, space, up, search)
    candidates = views_of(places, space, up, settings, down)
    poses = _chosen(candidates, search.rated(candidates, "looking at views"), space, settings)
    poses[:, :3, 3] -= poses[:, :3, :3] @ scene.origin
    return Viewpoints(poses, settings.camera, up, given is not None)


def _chosen(
    cam_from_scene: Float64Array, scores: Float64Array, space: Space, settings: ViewpointSettings
) -> Float64Array:
    """Of (N, 4, 4) poses those with a good score, the best first; where there are more than are
    wanted, those that are far from each other."""
    order = np.argsort(-scores, kind="stable")
    best = scores[order]
    limit = best[min(FIFTH, len(best) - 1)] - settings.margin
    kept = order[best >= max(limit, OUT_OF_SIGHT / 2)]
    if not len(kept):
        raise MapError(NOTHING)
    poses = np.asarray(cam_from_scene[kept])
    if len(poses) <= settings.most:
        return poses
    # A step of yaw is as far as a step of place.
    turn = 2.0 * np.sin(0.5 * np.deg2rad(settings.yaw_step))
    steps = camera_centres(poses) / lattice_spacing(space, settings)
    return poses[farthest_first(np.hstack([steps, poses[:, 2, :3] / turn]), settings.most)]
