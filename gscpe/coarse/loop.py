# SPDX-License-Identifier: Apache-2.0
"""The coarse loop (paper, Algorithm 1)."""

from __future__ import annotations

import logging
from typing import Any

from gscpe.arrays import Float64Array
from gscpe.coarse.one_round import CoarseResult, CoarseSettings, LikePhoto, Round, match_render
from gscpe.coarse.pnp import AbsolutePose
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import pose_difference
from gscpe.matching import Matcher, Matches
from gscpe.render import RenderedView, Renders

_log = logging.getLogger(__name__)


class CoarseObserver:
    """Its methods are called at each step of :func:`estimate_coarse_pose`. Override the methods
    that you need; do not change their arguments."""

    def round_done(
        self, view: RenderedView, matches: Matches, estimate: AbsolutePose | None
    ) -> None:
        """A render, its matches with the photo, and the pose that came of them. The first render
        of an easy photo is smaller than the photo; pixels are those of ``view.camera``."""


def estimate_coarse_pose(
    renderer: Renders,
    matcher: Matcher,
    prepared_photo: Any,
    camera: Camera,
    start_cam_from_world: Float64Array,
    settings: CoarseSettings,
    observer: CoarseObserver | None = None,
    like_photo: LikePhoto | None = None,
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
        like_photo: how renders are changed before they are matched, but for the first, which is
            not from near enough to be compared with the photo.
    """
    current = start_cam_from_world
    best: Round | None = None
    rounds, converged = 0, False
    while rounds < settings.max_rounds and not converged:
        view = renderer.render(camera, current)
        rounds += 1
        shown = like_photo if rounds > 1 else None
        this = match_render(view, matcher, prepared_photo, camera, settings, shown)
        if observer is not None:
            observer.round_done(view, this.matches, this.estimate)
        if best is None or (this.inliers and this.inliers >= 0.5 * best.inliers):
            # A later round sees the scene from nearer by: it replaces the earlier unless
            # it lost the place.
            best = this
        if this.estimate is None:
            _log.debug("round %d: no pose from %d matches", rounds, len(this.pixels))
            break
        if this.inliers < settings.min_inliers:
            _log.debug("round %d: %d matches agree, no better than chance", rounds, this.inliers)
            break
        moved = pose_difference(this.estimate.cam_from_world, current)
        _log.debug(
            "round %d: %d of %d matches agree, moved %.4f and %.3f deg",
            rounds, this.inliers, len(this.pixels), moved.distance, moved.degrees,
        )  # fmt: skip
        converged = this.has_settled(current, settings)
        current = this.estimate.cam_from_world
    assert best is not None
    return best.result(rounds, converged, settings)
