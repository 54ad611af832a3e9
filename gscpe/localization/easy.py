# SPDX-License-Identifier: Apache-2.0
"""Easy photos: one small render is matched, and the render that is aligned is matched again.

What further rounds of the coarse loop add is matches from the right place. The alignment renders
there anyway, so that render is matched with the photo while it is aligned. Where anything about
this is in doubt, the photo is not easy, and the whole loop is run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable

from gscpe.arrays import BoolArray, Float64Array
from gscpe.coarse import CoarseResult, CoarseSettings, Round, match_render
from gscpe.geometry.camera import Camera
from gscpe.localization.beside import Beside, Work
from gscpe.localization.observer import Observer
from gscpe.localization.prepared import PreparedPhoto
from gscpe.localization.verification import inlier_spread
from gscpe.matching import Matcher
from gscpe.refinement import Alignment, RefinementResult, RefinementSettings, refine_pose
from gscpe.render import RenderedView, Renders


@dataclass(frozen=True)
class EasySettings:
    """When a single round is enough to begin the alignment.

    Attributes:
        side: pixels of the shorter side of the render of this round, and of the photo for it;
            0: all photos go through the whole coarse loop.
        min_inliers: matches that must agree with a pose, ...
        min_inlier_share: ... as a share of all, ...
        min_spread: ... and share of a 4x4 grid over the photo that must hold one.
    """

    side: int = 240
    min_inliers: int = 60
    min_inlier_share: float = 0.5
    min_spread: float = 0.5


def is_easy(first: Round, settings: EasySettings) -> bool:
    """Whether the pose of a first round is good enough to align from."""
    return (
        first.inliers >= settings.min_inliers
        and first.inliers >= settings.min_inlier_share * len(first.pixels)
        and inlier_spread(first.inlier_pixels, first.camera) >= settings.min_spread
    )


def localize_easy(
    renderer: Renders,
    matcher: Matcher,
    query: PreparedPhoto,
    start_cam_from_world: Float64Array,
    beside: Beside,
    easy: EasySettings,
    coarse: CoarseSettings,
    refinement: RefinementSettings,
    observer: Observer,
) -> tuple[CoarseResult, RefinementResult] | None:
    """Matches and alignment with one render each; None where the photo is not easy.

    Args:
        renderer: of the map's splat.
        matcher: of photo and render.
        query: the photo.
        start_cam_from_world: (4, 4), the reference pose.
        beside: where the second match is made.
        easy, coarse, refinement: settings.
        observer: is told of both rounds, and of the alignment between them.
    """
    clock, small_camera = query.clock, query.small_camera
    with clock.stage("coarse"):
        view = renderer.render(small_camera, start_cam_from_world)
    small = query.prepared_for(matcher, small=True)
    with clock.stage("coarse"):
        first = match_render(view, matcher, small, small_camera, coarse)
    observer.round_done(view, first.matches, first.estimate)
    if first.estimate is None or not is_easy(first, easy):
        return None
    prepared = query.prepared_for(matcher)
    anchors = _AnchorsMatched(matcher, prepared, query.photo.camera, coarse, beside, observer)
    with clock.stage("refinement"):
        aligned = refine_pose(
            renderer, query.photo, first.estimate.cam_from_world, refinement, anchors
        )
    if aligned.cam_from_world is None:
        return None
    with clock.stage("coarse"):
        last = anchors.last()
        matched = last.result(2, last.has_settled(coarse), coarse)
    observer.round_done(last.view, last.matches, last.estimate)
    return matched, aligned


class _AnchorsMatched(Observer):
    """Matches each anchor while it is aligned, and hands on what it is told."""

    def __init__(
        self,
        matcher: Matcher,
        prepared_photo: Any,
        camera: Camera,
        settings: CoarseSettings,
        beside: Beside,
        observer: Observer,
    ) -> None:
        self._match: Callable[[RenderedView], Round] = lambda view: match_render(
            view, matcher, prepared_photo, camera, settings
        )
        self._beside = beside
        self._observer = observer
        self._last: Work[Round] | None = None

    def last(self) -> Round:
        """What came of the last anchor; waits for it."""
        assert self._last is not None
        return self._last.result()

    def anchor_rendered(self, view: RenderedView) -> None:
        if self._last is not None:
            self._last.drop()
        self._last = self._beside.begin(lambda: self._match(view))
        self._observer.anchor_rendered(view)

    def mask_made(self, mask: BoolArray) -> None:
        self._observer.mask_made(mask)

    def iterated(self, photo_from_anchor: Float64Array) -> None:
        self._observer.iterated(photo_from_anchor)

    def anchor_aligned(self, alignment: Alignment) -> None:
        self._observer.anchor_aligned(alignment)
