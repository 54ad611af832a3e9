# SPDX-License-Identifier: Apache-2.0
"""Easy photos: one small render is matched, then one from the right place, during the alignment.

What further rounds of the coarse loop add is matches from the right place. They are made while
the photo is aligned, with the same render. Where anything about this is in doubt, the photo
is not easy, and the whole loop is run. Measured: docs/benchmarks.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.arrays import Float64Array
from gscpe.coarse import CoarseResult, CoarseSettings, Round, match_render
from gscpe.errors import SettingsError
from gscpe.geometry.camera import Camera
from gscpe.geometry.spread import spread_over_image
from gscpe.localization.beside import Beside
from gscpe.localization.light import exposed_like
from gscpe.localization.observer import Observer
from gscpe.localization.prepared import PreparedPhoto
from gscpe.matching import Matcher
from gscpe.ranges import check_shares, check_whole
from gscpe.refinement import RefinementResult, RefinementSettings, refine_pose
from gscpe.render import Renders


@dataclass(frozen=True)
class EasySettings:
    """When a single round is enough to begin the alignment.

    Attributes:
        side: pixels of the shorter side of the render of this round, and of the photo for it.
            Photos that are not at least half as large again go through the whole coarse loop,
            which is fast with these; 0: all photos do.
        min_references: photos that the map must have. A splat of one RGB-D photo looks right from
            close by alone, so that there further rounds, from ever nearer, are worth their time.
        min_inliers: matches that must agree with a pose, ...
        min_inlier_share: ... as a share of all, ...
        min_spread: ... and share of a 4x4 grid over the photo that must hold one: more than a
            half, so that no photo of which half is covered is easy.

    Raises:
        SettingsError: a value is out of its range.
    """

    side: int = 240
    min_references: int = 2
    min_inliers: int = 60
    min_inlier_share: float = 0.5
    min_spread: float = 0.6

    def __post_init__(self) -> None:
        check_whole(self, "side", "min_references", least=0)
        check_whole(self, "min_inliers", least=1)
        check_shares(self, "min_inlier_share", "min_spread")
        if 0 < self.side < 16:
            raise SettingsError(
                f"easy photos are first looked at with 16 pixels or more (0: not at all), not side "
                f"{self.side}"
            )


def is_easy(first: Round, settings: EasySettings) -> bool:
    """Whether the pose of a first round is good enough to align from."""
    return (
        first.inliers >= settings.min_inliers
        and first.inliers >= settings.min_inlier_share * len(first.pixels)
        and spread_over_image(first.inlier_pixels, first.camera) >= settings.min_spread
    )


def localize_easy(
    renderer: Renders,
    matcher: Matcher,
    query: PreparedPhoto,
    small_camera: Camera,
    start_cam_from_world: Float64Array,
    beside: Beside,
    easy: EasySettings,
    coarse: CoarseSettings,
    refinement: RefinementSettings,
    observer: Observer,
) -> tuple[CoarseResult, RefinementResult] | None:
    """Two rounds of matches, and the alignment beside the second; None where the photo is not easy.

    Args:
        renderer: of the map's splat.
        matcher: of photo and render.
        query: the photo.
        small_camera: of the photo for the first look.
        start_cam_from_world: (4, 4), the reference pose.
        beside: where the second match is made.
        easy, coarse, refinement: settings.
        observer: is told of both rounds, and of the alignment between them.
    """
    clock = query.clock
    with clock.stage("coarse"):
        view = renderer.render(small_camera, start_cam_from_world)
    small = query.prepared_for(matcher, small=True)
    with clock.stage("coarse"):
        first = match_render(view, matcher, small, small_camera, coarse)
    observer.round_done(view, first.matches, first.estimate)
    if first.estimate is None or not is_easy(first, easy):
        return None
    camera, near = query.photo.camera, first.estimate.cam_from_world
    with clock.stage("coarse"):
        view = renderer.render(camera, near)
    prepared = query.prepared_for(matcher)

    def match() -> tuple[Round, CoarseResult]:
        like_photo = exposed_like(query.photo, refinement.light.clipping)
        second = match_render(view, matcher, prepared, camera, coarse, like_photo)
        return second, second.result(2, second.has_settled(near, coarse), coarse)

    matching = beside.begin(match)
    with clock.stage("refinement"):
        aligned = refine_pose(renderer, query.photo, near, refinement, observer, view)
    if aligned.cam_from_world is None:
        matching.drop()
        return None
    with clock.stage("coarse"):
        second, matched = matching.result()
    observer.round_done(second.view, second.matches, second.estimate)
    return matched, aligned
