# SPDX-License-Identifier: Apache-2.0
"""Which pixels of an anchor render can be trusted (paper, section on the visibility mask)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import BoolArray, Float64Array
from gscpe.geometry import se3
from gscpe.geometry.projection import unproject_image
from gscpe.ranges import check_numbers, check_shares, check_whole
from gscpe.refinement.products import compiled_loops
from gscpe.render import RenderedView, Renders

OPAQUE = 0.9
"""Opacity from which a pixel of a render shows a surface, unless settings say otherwise."""

_BEHIND = 1e-6


@dataclass(frozen=True)
class VisibilitySettings:
    """Settings of the mask.

    Attributes:
        min_opacity: tau_alpha, below it a pixel shows a hole.
        views: V, renders from perturbed poses that vote; 0: none. (On three maps, poses without
            these votes were better by up to a sixth: beside edges of depth, the votes cost pixels
            that are right. And they cost a fifth of the whole time.)
        depth_tolerance: tau_d, metres, by which a view's depth may differ.
        min_votes: tau_e, the share of the views that see a pixel and must agree.
        perturbation: metres by which the views stand beside the anchor.
        view_scale: size of the views relative to the anchor.
        max_depth_step: relative difference of depth among 3x3 pixels that is an edge.

    Raises:
        SettingsError: a value is out of its range.
    """

    min_opacity: float = OPAQUE
    views: int = 0
    depth_tolerance: float = 0.02
    min_votes: float = 0.3
    perturbation: float = 0.05
    view_scale: float = 0.25
    max_depth_step: float = 0.1

    def __post_init__(self) -> None:
        check_whole(self, "views", least=0)
        check_shares(self, "min_opacity", "min_votes")
        check_numbers(self, "view_scale", above=0, most=1)
        check_numbers(self, "perturbation", least=0)
        check_numbers(self, "depth_tolerance", "max_depth_step", least=0, infinite=True)


def surface_mask(view: RenderedView, settings: VisibilitySettings) -> BoolArray:
    """Pixels, (H, W), that show an opaque surface and no edge between two."""
    depth = view.depth
    kernel = np.ones((3, 3), dtype=np.uint8)
    nearest, farthest = cv2.erode(depth, kernel), cv2.dilate(depth, kernel)
    smooth = (farthest - nearest) <= settings.max_depth_step * np.maximum(nearest, 1e-9)
    return np.asarray((view.opacity >= settings.min_opacity) & (nearest > 0) & smooth)


def visibility_mask(
    renderer: Renders,
    anchor: RenderedView,
    settings: VisibilitySettings,
    metres_per_unit: float,
) -> BoolArray:
    """The surface mask without pixels whose depth perturbed views contradict.

    A pixel's point, ``X = depth * K^-1 x``, is looked up in view v with
    ``v_from_anchor = v_from_world @ world_from_anchor`` (the paper writes the transforms of
    camera-to-world poses); the view votes for it when its rendered depth there is the
    point's depth to tau_d. Where no view sees the point, the surface mask decides.
    """
    mask = surface_mask(anchor, settings)
    if settings.views == 0 or not np.any(mask):
        return mask
    camera = anchor.camera
    small = camera.resized(
        max(1, round(camera.width * settings.view_scale)),
        max(1, round(camera.height * settings.view_scale)),
    )
    tolerance = settings.depth_tolerance / metres_per_unit
    seen, votes = np.zeros((2, *mask.shape), dtype=np.uint16)
    for view_from_anchor in _perturbations(settings, metres_per_unit):
        view = renderer.render(small, view_from_anchor @ anchor.cam_from_world)
        _vote(anchor, mask, view, view_from_anchor, tolerance, seen, votes)
    return np.asarray(mask & (votes >= settings.min_votes * seen))  # also where no view sees


def _perturbations(settings: VisibilitySettings, metres_per_unit: float) -> list[Float64Array]:
    """V poses on a circle around the anchor, in its image plane."""
    angles = 2.0 * np.pi * (np.arange(settings.views) + 0.5) / settings.views
    radius = settings.perturbation / metres_per_unit
    return [
        se3.exp([radius * np.cos(angle), radius * np.sin(angle), 0.0, 0.0, 0.0, 0.0])
        for angle in angles
    ]


def _vote(
    anchor: RenderedView,
    mask: BoolArray,
    view: RenderedView,
    view_from_anchor: Float64Array,
    tolerance: float,
    seen: NDArray[np.uint16],
    votes: NDArray[np.uint16],
) -> None:
    """Counts where a view sees the anchor's pixels within the mask, and where it agrees: where a
    point's depth is in the range of the rendered depth in the 3x3 pixels where it projects.

    The range, and not one depth, because a small view has large pixels: on a slanted
    surface neighbouring depths differ by more than any tolerance for errors.
    """
    kernel = np.ones((3, 3), dtype=np.uint8)
    known = view.depth > 0
    nearest = cv2.erode(np.where(known, view.depth, np.float32(np.inf)), kernel)
    farthest = cv2.dilate(view.depth, kernel)
    loops = compiled_loops()
    if loops is not None:
        loops.vote(
            *(anchor.depth, anchor.camera, mask, view.camera, view_from_anchor),
            *(nearest, farthest, known, tolerance, seen, votes),
        )
        return
    points = unproject_image(anchor.camera, anchor.depth)[:, mask.ravel()]
    moved = view_from_anchor[:3, :3] @ points + view_from_anchor[:3, 3, None]
    ahead = moved[2] > _BEHIND
    z = np.where(ahead, moved[2], 1.0)
    u = moved[0] / z * view.camera.fx + view.camera.cx
    v = moved[1] / z * view.camera.fy + view.camera.cy
    height, width = known.shape
    inside = ahead & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    column = np.clip(u, 0, width - 1).astype(np.intp)
    row = np.clip(v, 0, height - 1).astype(np.intp)
    inside &= known[row, column]
    seen[mask] += inside
    votes[mask] += (
        inside
        & (moved[2] > nearest[row, column] - tolerance)
        & (moved[2] < farthest[row, column] + tolerance)
    )
