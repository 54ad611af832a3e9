"""One try to localize a photo: where it began, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.clock import Clock
from gscpe.coarse import CoarseResult
from gscpe.fusion import fuse_matches_and_alignment
from gscpe.localization_result import LocalizationResult, StartedFrom
from gscpe.matching import Matcher
from gscpe.refinement import RefinementResult
from gscpe.scene import Photo


@dataclass(frozen=True, eq=False)
class Start:
    """Where an attempt begins."""

    kind: StartedFrom
    cam_from_world: Float64Array
    reference: str | None = None


@dataclass(frozen=True, eq=False)
class Attempt:
    """What came of one start."""

    start: Start
    coarse: CoarseResult | None
    refined: RefinementResult | None
    doubt: str | None

    def rank(self) -> tuple[bool, float, int]:
        """The better of two attempts ranks higher."""
        agreement = self.refined.agreement if self.refined else -1.0
        inliers = self.coarse.inliers if self.coarse else 0
        return self.doubt is None, -1.0 if np.isnan(agreement) else agreement, inliers


class Query:
    """A photo, and what the matcher makes of it, once it is needed."""

    def __init__(self, photo: Photo, matcher: Matcher, clock: Clock) -> None:
        self.photo = photo
        self.clock = clock
        self._matcher = matcher

    @cached_property
    def prepared(self) -> Any:
        with self.clock.stage("features"):
            return self._matcher.prepare(self.photo.rgb, self.photo.valid)


def to_result(best: Attempt | None, tried: int, clock: Clock) -> LocalizationResult:
    if best is None:
        reason = "the photo has no features to recognize a place by"
        return LocalizationResult(
            False, reason, None, None, None, None, None, None, 0, clock.seconds()
        )
    pose, covariance = (None, None) if best.doubt is not None else _final_pose(best)
    return LocalizationResult(
        localized=pose is not None,
        reason=best.doubt,
        cam_from_world=pose,
        covariance=covariance,
        started_from=best.start.kind,
        reference=best.start.reference,
        coarse=best.coarse,
        refined=best.refined,
        hypotheses=tried,
        seconds=clock.seconds(),
    )


def _final_pose(attempt: Attempt) -> tuple[Float64Array, Float64Array]:
    """Of an attempt that is not doubted: matches and alignment together."""
    coarse, refined = attempt.coarse, attempt.refined
    assert refined is not None
    assert refined.cam_from_world is not None
    assert refined.covariance is not None
    if coarse is None or coarse.cam_from_world is None or coarse.covariance is None:
        return refined.cam_from_world, refined.covariance
    return fuse_matches_and_alignment(
        coarse.cam_from_world, coarse.covariance, refined.cam_from_world, refined.covariance
    )
