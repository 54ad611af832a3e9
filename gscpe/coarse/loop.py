# SPDX-License-Identifier: Apache-2.0
"""The coarse loop (paper, Algorithm 1)."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gscpe.arrays import Float64Array, short_repr
from gscpe.coarse.focal import FocalEstimate, check_focal_length
from gscpe.coarse.lift import lift
from gscpe.coarse.pnp import AbsolutePose, PnPSettings, estimate_absolute_pose
from gscpe.errors import SettingsError
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import pose_difference
from gscpe.matching import Matcher, Matches
from gscpe.render import RenderedView, Renders
from gscpe.scene import to_uint8

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class CoarseSettings:
    """Settings of the coarse loop; the defaults are the paper's where it gives one.

    Attributes:
        max_rounds: N_c, renders at most.
        translation_tolerance: epsilon_t, metres; the loop ends when a round moves the
            camera less than this and ...
        rotation_tolerance_degrees: epsilon_R, ... turns it less than this.
        min_inliers: a round on which fewer matches agree is chance, and ends the loop.
        min_opacity: below it a rendered pixel has no surface; nothing is matched there.
        pnp: of each round.
    """

    max_rounds: int = 3
    translation_tolerance: float = 0.02
    rotation_tolerance_degrees: float = 0.02
    min_inliers: int = 8
    min_opacity: float = 0.5
    pnp: PnPSettings = field(default_factory=PnPSettings)

    def __post_init__(self) -> None:
        if self.max_rounds < 1:
            raise SettingsError("the coarse loop needs at least one round")


@dataclass(frozen=True, eq=False)
class CoarseResult:
    """The result of the coarse loop.

    Attributes:
        cam_from_world: (4, 4) pose of the best round; None when no round found one.
        matches: matches of that round that could be lifted.
        inliers: those that agree with the pose.
        inlier_pixels: (inliers, 2) where they are in the photo.
        rms_pixels: their reprojection error.
        rounds: renders made.
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``; None where there is no pose.
        converged: whether the last round moved the pose less than the tolerances.
        focal: pose and focal length that fit the matches best if the camera's focal length is left
            free; None if there is no pose, or few matches agree.
    """

    cam_from_world: Float64Array | None
    matches: int
    inliers: int
    inlier_pixels: Float64Array
    rms_pixels: float
    covariance: Float64Array | None
    rounds: int
    converged: bool
    focal: FocalEstimate | None = None

    def __repr__(self) -> str:
        return short_repr(self)


class CoarseObserver:
    """Its methods are called at each step of :func:`estimate_coarse_pose`. Override the methods
    that you need; do not change their arguments."""

    def round_done(
        self, view: RenderedView, matches: Matches, estimate: AbsolutePose | None
    ) -> None:
        """A render, its matches with the photo, and the pose that came of them."""


def estimate_coarse_pose(
    renderer: Renders,
    matcher: Matcher,
    prepared_photo: Any,
    camera: Camera,
    start_cam_from_world: Float64Array,
    settings: CoarseSettings,
    observer: CoarseObserver | None = None,
) -> CoarseResult:
    """Renders the map at the current pose, matches, lifts, solves, and repeats.

    Args:
        renderer: of the map's splat.
        matcher: which prepared the photo.
        prepared_photo: ``matcher.prepare(photo)``.
        camera: pinhole camera of the photo.
        start_cam_from_world: (4, 4), the reference pose.
        settings: see :class:`CoarseSettings`.
        observer: is told of each round.
    """
    current = start_cam_from_world
    best: AbsolutePose | None = None
    best_points, best_pixels = np.zeros((0, 3)), np.zeros((0, 2))
    rounds, converged = 0, False
    while rounds < settings.max_rounds and not converged:
        view = renderer.render(camera, current)
        rounds += 1
        seen = view.opacity >= settings.min_opacity
        matches = matcher.match(prepared_photo, matcher.prepare(to_uint8(view.rgb), seen))
        points_world, liftable = lift(view, matches.render_pixels, settings.min_opacity)
        pixels = matches.photo_pixels[liftable]
        estimate = estimate_absolute_pose(
            points_world[liftable], pixels, camera, current, settings.pnp
        )
        if observer is not None:
            observer.round_done(view, matches, estimate)
        if estimate is None:
            _log.debug("round %d: no pose from %d matches", rounds, len(pixels))
            break
        if best is None or estimate.inliers.sum() >= 0.5 * best.inliers.sum():
            # A later round sees the scene from nearer by: it replaces the earlier unless
            # it lost the place.
            best, best_points, best_pixels = estimate, points_world[liftable], pixels
        if estimate.inliers.sum() < settings.min_inliers:
            _log.debug(
                "round %d: %d matches agree, no better than chance", rounds, len(best_pixels)
            )
            break
        moved = pose_difference(estimate.cam_from_world, current)
        _log.debug(
            "round %d: %d of %d matches agree, moved %.4f and %.3f deg",
            rounds, estimate.inliers.sum(), len(pixels), moved.distance, moved.degrees,
        )  # fmt: skip
        converged = (
            moved.distance < settings.translation_tolerance
            and moved.degrees < settings.rotation_tolerance_degrees
        )
        current = estimate.cam_from_world
    return CoarseResult(
        cam_from_world=None if best is None else best.cam_from_world,
        matches=len(best_pixels),
        inliers=0 if best is None else int(best.inliers.sum()),
        inlier_pixels=best_pixels if best is None else best_pixels[best.inliers],
        rms_pixels=float("nan") if best is None else best.rms_pixels,
        covariance=None if best is None else best.covariance,
        rounds=rounds,
        converged=converged,
        focal=None
        if best is None
        else check_focal_length(
            best_points, best_pixels, camera, best.cam_from_world, settings.pnp
        ),
    )
