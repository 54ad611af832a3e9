# SPDX-License-Identifier: Apache-2.0
"""One try to localize a photo: where it began, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.coarse import CoarseResult
from gscpe.localization.starts import Start
from gscpe.refinement import RefinementResult


@dataclass(frozen=True, eq=False)
class Attempt:
    """The result of one start.

    Attributes:
        start: where it started.
        coarse: the pose of the matches, trusted or not; None for tracking. Of an easy photo, of
            those with the render that was aligned.
        aligned: result of the refinement; None when the coarse pose was not trusted.
        doubt: why the pose cannot be trusted; None when it can.
        orientation: how the photo was turned before matching, as an EXIF orientation; 1: not
            turned. Poses and pixels are those of the photo that was given.
        matcher: of photo and render, as :func:`gscpe.make_matcher` names it; None for tracking.
    """

    start: Start
    coarse: CoarseResult | None
    aligned: RefinementResult | None
    doubt: str | None
    orientation: int = 1
    matcher: str | None = None

    def __repr__(self) -> str:
        begun = f" {self.start.reference}" if self.start.reference else ""
        turned = f", turned {self.orientation}" if self.orientation != 1 else ""
        by = f", {self.matcher}" if self.matcher else ""
        return f"Attempt(from {self.start.kind}{begun}{by}{turned}: {self.doubt or 'ok'})"

    def rank(self) -> tuple[bool, float, int]:
        """The better of two attempts ranks higher."""
        agreement = self.aligned.agreement if self.aligned else -1.0
        inliers = self.coarse.inliers if self.coarse else 0
        return self.doubt is None, -1.0 if np.isnan(agreement) else agreement, inliers
