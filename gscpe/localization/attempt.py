# SPDX-License-Identifier: Apache-2.0
"""One try to localize a photo: where it began, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gscpe.coarse import CoarseResult
from gscpe.localization.clock import Clock
from gscpe.localization.starts import Start
from gscpe.matching import Matcher
from gscpe.refinement import RefinementResult
from gscpe.scene import Photo


@dataclass(frozen=True, eq=False)
class Attempt:
    """The result of one start.

    Attributes:
        start: where it started.
        coarse: result of the coarse stage, trusted or not; None for tracking.
        aligned: result of the refinement; None when the coarse pose was not trusted.
        doubt: why the pose cannot be trusted; None when it can.
        orientation: how the photo was turned before matching, as an EXIF orientation; 1: not
            turned. Poses and pixels are those of the photo that was given.
    """

    start: Start
    coarse: CoarseResult | None
    aligned: RefinementResult | None
    doubt: str | None
    orientation: int = 1

    def __repr__(self) -> str:
        begun = f" {self.start.reference}" if self.start.reference else ""
        return f"Attempt(from {self.start.kind}{begun}: {self.doubt or 'ok'})"

    def rank(self) -> tuple[bool, float, int]:
        """The better of two attempts ranks higher."""
        agreement = self.aligned.agreement if self.aligned else -1.0
        inliers = self.coarse.inliers if self.coarse else 0
        return self.doubt is None, -1.0 if np.isnan(agreement) else agreement, inliers


class PreparedPhoto:
    """A photo that is being localized, and what the matcher makes of it once it is needed.

    Args:
        photo: turned, where it was.
        matcher: of photo and render.
        clock: counts the time of its features.
        orientation: how the photo was turned, EXIF's number.
    """

    def __init__(self, photo: Photo, matcher: Matcher, clock: Clock, orientation: int = 1) -> None:
        self.orientation = orientation
        self.photo = photo
        self.clock = clock
        self._matcher = matcher

    @cached_property
    def for_matching(self) -> Any:
        """``matcher.prepare(photo)``, made once."""
        with self.clock.stage("features"):
            return self._matcher.prepare(self.photo.rgb, self.photo.valid)
