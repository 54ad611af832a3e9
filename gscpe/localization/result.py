# SPDX-License-Identifier: Apache-2.0
"""What a localizer answers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.coarse import CoarseResult
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.localization.attempt import Attempt
from gscpe.localization.border import attempt_in_world
from gscpe.localization.fusion import fuse_matches_and_alignment
from gscpe.localization.settings import LocalizerSettings
from gscpe.localization.starts import StartedFrom
from gscpe.localization.wrong_camera import contradiction
from gscpe.refinement import RefinementResult
from gscpe.scene import MapFrame

NO_FEATURES = (
    "the photo has no features to recognize a place by: try one with more edges and texture in view"
)


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
            map's world units and radians; None when not localized. Like those of both stages, it
            includes the uncertainty of the camera (``Camera.covariance``); and how far the matches
            contradict it.
        camera: that was given, or estimated (then with a covariance).
        best: the attempt that the result comes from; None when there was nothing to start from.
        attempts: all attempts, in order.
        seconds: wall time by stage: features, retrieval, coarse, refinement, total.
        metres_per_unit: length of a world unit in metres; None where it is not known.
    """

    localized: bool
    reason: str | None
    cam_from_world: Float64Array | None
    covariance: Float64Array | None
    camera: Camera
    best: Attempt | None
    attempts: tuple[Attempt, ...]
    seconds: dict[str, float]
    metres_per_unit: float | None = None

    @classmethod
    def of(
        cls,
        attempts: Sequence[Attempt],
        camera: Camera,
        frame: MapFrame,
        settings: LocalizerSettings,
        seconds: dict[str, float],
    ) -> LocalizationResult:
        """The result with the best of the attempts.

        Args:
            attempts: with respect to the map.
            camera: that was given.
            frame: of the map; the answer is with respect to the world.
            settings: of fusion and verification.
            seconds: see above.
        """
        best = max(attempts, key=Attempt.rank, default=None)
        if best is None:
            return cls(
                *(False, NO_FEATURES, None, None, camera, None, (), seconds),
                metres_per_unit=frame.metres_per_unit,
            )
        in_world = tuple(
            attempt_in_world(_unsure_of_camera(attempt, camera), frame) for attempt in attempts
        )
        pose = covariance = None
        if best.doubt is None:
            cam_from_map, in_map_units = _final_pose(best, camera, settings)
            pose, covariance = (
                frame.cam_from_world(cam_from_map),
                frame.world_covariance(in_map_units),
            )
        return cls(
            localized=pose is not None,
            reason=best.doubt,
            cam_from_world=pose,
            covariance=covariance,
            camera=camera,
            best=in_world[attempts.index(best)],
            attempts=in_world,
            seconds=seconds,
            metres_per_unit=frame.metres_per_unit,
        )

    def because(self, cause: str | None) -> LocalizationResult:
        """The same answer, its reason explained by a cause, if there is one."""
        if cause is None:
            return self
        reason = cause if self.best is None else f"{self.reason}; {cause}"
        return replace(self, reason=reason)

    def _for_people(self) -> dict[str, str]:
        """What a reader wants to know first: headings and text."""
        rows = {"status": "localized" if self.localized else "not localized"}
        if self.reason is not None:
            rows["reason"] = self.reason
        if self.cam_from_world is not None:
            rows["qw qx qy qz tx ty tz"] = _pose_text(self.cam_from_world)
        if self.covariance is not None:
            rows["standard deviations"] = deviations_text(self.covariance, self.metres_per_unit)
        if self.best is not None:
            rows["began at"] = f"{self.started_from} {self.reference or ''}".strip()
            rows["attempts"] = str(len(self.attempts))
        if "total" in self.seconds:
            rows["seconds"] = f"{self.seconds['total']:.2f}"
        return rows

    def __repr__(self) -> str:
        rows = self._for_people()
        lines = (f"  {name}: {text}" for name, text in rows.items() if name != "status")
        return "\n".join([f"LocalizationResult: {rows['status']}", *lines])

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        from html import escape

        rows = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>"
            for name, text in self._for_people().items()
        )
        return f"<table>{rows}</table>"

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


def deviations_text(covariance: Float64Array, metres_per_unit: float | None) -> str:
    """Standard deviations of a (6, 6) covariance, as text for people: lengths in metres, or in
    world units where the length of these is not known."""
    deviations = np.sqrt(np.diag(covariance))
    lengths, degrees = (metres_per_unit or 1.0) * deviations[:3], np.degrees(deviations[3:])
    unit = "world units" if metres_per_unit is None else "m"
    return (
        f"{' '.join(f'{x:.2g}' for x in lengths)} {unit}, "
        f"{' '.join(f'{x:.2g}' for x in degrees)} degrees (x y z of the camera)"
    )


def _pose_text(cam_from_world: Float64Array) -> str:
    quaternion, translation = se3.to_quaternion_translation(cam_from_world)
    return " ".join(f"{number:.6f}" for number in (*quaternion, *translation))


def _final_pose(
    attempt: Attempt, camera: Camera, settings: LocalizerSettings
) -> tuple[Float64Array, Float64Array]:
    """Of an attempt that is not doubted: matches and alignment together."""
    coarse, aligned = attempt.coarse, attempt.aligned
    assert aligned is not None
    assert aligned.cam_from_world is not None
    assert aligned.covariance is not None
    pose, covariance = aligned.cam_from_world, aligned.covariance
    of_camera = camera.covariance_matrix()
    if coarse is not None and coarse.cam_from_world is not None and coarse.covariance is not None:
        pose, covariance = fuse_matches_and_alignment(
            coarse.cam_from_world,
            coarse.covariance,
            pose,
            covariance,
            settings.fusion,
            aligned.unshared,
        )
        of_camera += contradiction(coarse, camera, settings.verification.camera).covariance
    # A wrong camera moves matches and alignment alike, so it counts after their mean.
    return pose, covariance + _of_camera(aligned, of_camera)


def _of_camera(aligned: RefinementResult, covariance: Float64Array) -> Float64Array:
    """(6, 6), what a pose is unsure by because its camera is, (5, 5)."""
    if aligned.by_camera is None:
        return np.zeros((6, 6))
    return np.asarray(aligned.by_camera @ covariance @ aligned.by_camera.T)


def _unsure_of_camera(attempt: Attempt, camera: Camera) -> Attempt:
    """The same, both stages as unsure as their camera makes them."""
    coarse, aligned = attempt.coarse, attempt.aligned
    if aligned is None or aligned.covariance is None:
        return attempt
    more = _of_camera(aligned, camera.covariance_matrix())
    aligned = replace(aligned, covariance=aligned.covariance + more)
    if coarse is not None and coarse.covariance is not None:
        coarse = replace(coarse, covariance=coarse.covariance + more)
    return replace(attempt, coarse=coarse, aligned=aligned)
