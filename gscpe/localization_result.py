"""What a localizer answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gscpe.arrays import Float64Array
from gscpe.coarse import CoarseResult
from gscpe.refinement import RefinementResult

StartedFrom = Literal["reference", "prior", "tracking"]


@dataclass(frozen=True, eq=False)
class LocalizationResult:
    """Where a photo was taken, or why that is not known.

    Attributes:
        localized: whether the pose can be trusted.
        reason: why not; None when localized.
        cam_from_world: (4, 4) float64, world to camera; None when not localized.
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``, (translation, rotation),
            map units and radians; None when not localized.
        started_from: ``"reference"``: a retrieved reference photo; ``"prior"``: the pose that
            the caller gave; ``"tracking"``: that pose, near enough to need no coarse stage;
            None when there was nowhere to start.
        reference: name of the reference photo, None for the other starts.
        coarse: result of the coarse stage, trusted or not; None for tracking.
        refined: result of the refinement; None when the coarse pose was not trusted.
        hypotheses: starts that were tried.
        seconds: wall time by stage: features, retrieval, coarse, refinement, total.
    """

    localized: bool
    reason: str | None
    cam_from_world: Float64Array | None
    covariance: Float64Array | None
    started_from: StartedFrom | None
    reference: str | None
    coarse: CoarseResult | None
    refined: RefinementResult | None
    hypotheses: int
    seconds: dict[str, float]
