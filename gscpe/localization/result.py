"""What a localizer answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

from gscpe.arrays import Float64Array
from gscpe.coarse import CoarseResult
from gscpe.localization.attempt import Attempt
from gscpe.localization.border import attempt_in_world
from gscpe.localization.fusion import FusionSettings, fuse_matches_and_alignment
from gscpe.localization.starts import StartedFrom
from gscpe.refinement import RefinementResult
from gscpe.scene import MapFrame

NO_FEATURES = "the photo has no features to recognize a place by"


@dataclass(frozen=True, eq=False)
class LocalizationResult:
    """Where a photo was taken, or why that is not known.

    Three poses: ``coarse.cam_from_world`` of the matches, ``aligned.cam_from_world`` of the image
    alignment, and ``cam_from_world``, the final one: the mean of both, by covariance.

    Attributes:
        localized: whether the pose can be trusted.
        reason: why not; None when localized.
        cam_from_world: (4, 4) float64, world to camera, the final pose; None when not localized.
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``, (translation, rotation), the
            map's world units and radians; None when not localized.
        best: the attempt that the answer is of; None when there was nowhere to start.
        attempts: all that was tried, in this order.
        seconds: wall time by stage: features, retrieval, coarse, refinement, total.
    """

    localized: bool
    reason: str | None
    cam_from_world: Float64Array | None
    covariance: Float64Array | None
    best: Attempt | None
    attempts: tuple[Attempt, ...]
    seconds: dict[str, float]

    @classmethod
    def of(
        cls,
        attempts: Sequence[Attempt],
        frame: MapFrame,
        settings: FusionSettings,
        seconds: dict[str, float],
    ) -> LocalizationResult:
        """The best of the attempts, as an answer.

        Args:
            attempts: with respect to the map.
            frame: of the map; the answer is with respect to the world.
            settings: how matches and alignment are weighed.
            seconds: see above.
        """
        best = max(attempts, key=Attempt.rank, default=None)
        if best is None:
            return cls(False, NO_FEATURES, None, None, None, (), seconds)
        pose = covariance = None
        if best.doubt is None:
            cam_from_map, in_map_units = _final_pose(best, settings)
            pose, covariance = (
                frame.cam_from_world(cam_from_map),
                frame.world_covariance(in_map_units),
            )
        return cls(
            localized=pose is not None,
            reason=best.doubt,
            cam_from_world=pose,
            covariance=covariance,
            best=attempt_in_world(best, frame),
            attempts=tuple(attempt_in_world(attempt, frame) for attempt in attempts),
            seconds=seconds,
        )

    @property
    def coarse(self) -> CoarseResult | None:
        """Of the best attempt: result of the coarse stage, trusted or not; None for tracking."""
        return None if self.best is None else self.best.coarse

    @property
    def aligned(self) -> RefinementResult | None:
        """Of the best attempt: result of the refinement; None when the coarse pose was not
        trusted."""
        return None if self.best is None else self.best.aligned

    @property
    def started_from(self) -> StartedFrom | None:
        """The kind of the best attempt's start; see :class:`gscpe.Start`."""
        return None if self.best is None else self.best.start.kind

    @property
    def reference(self) -> str | None:
        """Name of the reference photo that the best attempt began with, if it did."""
        return None if self.best is None else self.best.start.reference


def _final_pose(attempt: Attempt, settings: FusionSettings) -> tuple[Float64Array, Float64Array]:
    """Of an attempt that is not doubted: matches and alignment together."""
    coarse, aligned = attempt.coarse, attempt.aligned
    assert aligned is not None
    assert aligned.cam_from_world is not None
    assert aligned.covariance is not None
    if coarse is None or coarse.cam_from_world is None or coarse.covariance is None:
        return aligned.cam_from_world, aligned.covariance
    return fuse_matches_and_alignment(
        coarse.cam_from_world,
        coarse.covariance,
        aligned.cam_from_world,
        aligned.covariance,
        settings,
        aligned.unshared,
    )
