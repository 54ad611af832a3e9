# SPDX-License-Identifier: Apache-2.0
"""One round of Algorithm 1: a render is matched with the photo, lifted, and solved for the pose."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable

import numpy as np

from gscpe.arrays import Float32Array, Float64Array, short_repr
from gscpe.coarse.intrinsics import CameraEstimate, check_intrinsics
from gscpe.coarse.lift import lift
from gscpe.coarse.pnp import AbsolutePose, PnPSettings, estimate_absolute_pose
from gscpe.coarse.rival import RivalSettings, better_spread, find_rival
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import pose_difference
from gscpe.matching import Matcher, Matches
from gscpe.photos import to_uint8
from gscpe.ranges import check_kinds, check_numbers, check_shares, check_whole
from gscpe.render import RenderedView

LikePhoto = Callable[[RenderedView], Float32Array]
"""The colours of a render from near the photo's pose, (H, W, 3), as the photo shows them."""


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
        rival: when a second pose counts, on which many of the matches agree.

    Raises:
        SettingsError: a value is out of its range.
    """

    max_rounds: int = 3
    translation_tolerance: float = 0.02
    rotation_tolerance_degrees: float = 0.02
    min_inliers: int = 8
    min_opacity: float = 0.5
    pnp: PnPSettings = field(default_factory=PnPSettings)
    rival: RivalSettings = field(default_factory=RivalSettings)

    def __post_init__(self) -> None:
        check_whole(self, "max_rounds", least=1)
        check_whole(self, "min_inliers", least=0)
        check_numbers(self, "translation_tolerance", "rotation_tolerance_degrees", least=0)
        check_shares(self, "min_opacity")
        check_kinds(self, pnp=PnPSettings, rival=RivalSettings)


@dataclass(frozen=True, eq=False)
class CoarseResult:
    """The result of the coarse stage.

    Attributes:
        cam_from_world: (4, 4) pose of the best round; None when no round found one.
        matches: matches of that round that could be lifted.
        inliers: those that agree with the pose.
        inlier_pixels: (inliers, 2) where they are in the photo.
        rms_pixels: their reprojection error.
        rival_pixels: (N, 2) where matches are that agree on another pose, which contradicts this
            one; none where there is no such pose.
        rounds: renders that were matched.
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``; None where there is no pose.
        converged: whether the last round moved the pose less than the tolerances.
        intrinsics: pose and camera that fit the matches best if the camera's intrinsics are left
            free; None if there is no pose, or few matches agree.
    """

    cam_from_world: Float64Array | None
    matches: int
    inliers: int
    inlier_pixels: Float64Array
    rival_pixels: Float64Array
    rms_pixels: float
    covariance: Float64Array | None
    rounds: int
    converged: bool
    intrinsics: CameraEstimate | None = None

    def __repr__(self) -> str:
        return short_repr(self)


@dataclass(frozen=True, eq=False)
class Round:
    """A render that was matched with the photo.

    Attributes:
        view: the render.
        camera: of the photo.
        matches: of both.
        points_world, pixels: (N, 3) and (N, 2), the matches that could be lifted.
        estimate: the pose that most of them agree on; None where there is none.
        rival: another one that many of the others agree on; None where there is none.
    """

    view: RenderedView
    camera: Camera
    matches: Matches
    points_world: Float64Array
    pixels: Float64Array
    estimate: AbsolutePose | None
    rival: AbsolutePose | None = None

    @property
    def inliers(self) -> int:
        """Matches that agree with the pose."""
        return 0 if self.estimate is None else int(self.estimate.inliers.sum())

    @property
    def inlier_pixels(self) -> Float64Array:
        """(inliers, 2), where they are in the photo."""
        return self.pixels[:0] if self.estimate is None else self.pixels[self.estimate.inliers]

    def has_settled(self, cam_from_world: Float64Array, settings: CoarseSettings) -> bool:
        """Whether the pose is that of the round before, within the tolerances."""
        if self.estimate is None:
            return False
        moved = pose_difference(self.estimate.cam_from_world, cam_from_world)
        return (
            moved.distance < settings.translation_tolerance
            and moved.degrees < settings.rotation_tolerance_degrees
        )

    def result(self, rounds: int, converged: bool, settings: CoarseSettings) -> CoarseResult:
        """The coarse pose, where this is the best round of so many."""
        best = self.estimate
        intrinsics = None
        if best is not None:
            intrinsics = check_intrinsics(
                self.points_world, self.pixels, self.camera, best.cam_from_world, settings.pnp
            )
        return CoarseResult(
            cam_from_world=None if best is None else best.cam_from_world,
            matches=len(self.pixels),
            inliers=self.inliers,
            inlier_pixels=self.inlier_pixels,
            rival_pixels=self.pixels[:0] if self.rival is None else self.pixels[self.rival.inliers],
            rms_pixels=float("nan") if best is None else best.rms_pixels,
            covariance=None if best is None else best.covariance,
            rounds=rounds,
            converged=converged,
            intrinsics=intrinsics,
        )


def match_render(
    view: RenderedView,
    matcher: Matcher,
    prepared_photo: Any,
    camera: Camera,
    settings: CoarseSettings,
    like_photo: LikePhoto | None = None,
) -> Round:
    """Matches a render with the photo and solves for the photo's pose.

    Args:
        view: the render; its pose competes with the sampled one.
        matcher: which prepared the photo.
        prepared_photo: ``matcher.prepare(photo)``.
        camera: pinhole camera of the photo.
        settings: see :class:`CoarseSettings`.
        like_photo: how the render is changed before it is matched; None: not at all.
    """
    seen = view.opacity >= settings.min_opacity
    rgb = view.rgb if like_photo is None else like_photo(view)
    matches = matcher.match(prepared_photo, matcher.prepare(to_uint8(rgb), seen))
    points_world, liftable = lift(view, matches.render_pixels, settings.min_opacity)
    points_world, pixels = points_world[liftable], matches.photo_pixels[liftable]
    prior = np.asarray(view.cam_from_world)
    matched = points_world, pixels, camera
    estimate = estimate_absolute_pose(*matched, prior, settings.pnp)
    rival = None
    if estimate is not None:
        rival = find_rival(*matched, prior, estimate, settings.pnp, settings.rival)
    if estimate is not None and rival is not None:
        estimate, rival = better_spread(*matched, estimate, rival, settings.pnp)
    return Round(view, camera, matches, points_world, pixels, estimate, rival)
