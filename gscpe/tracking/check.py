# SPDX-License-Identifier: Apache-2.0
"""Now and then, matches with a render confirm the pose: a wrong one does not live long.

An alignment can settle in a wrong place that looks alike, such as the next of many windows; once
there, every frame agrees with the last. Matches are another witness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import pose_difference
from gscpe.localization import Attempt, Localizer
from gscpe.tracking.background import Errand
from gscpe.tracking.follow import Followed
from gscpe.tracking.frames import Frame
from gscpe.tracking.settings import TrustSettings

_DEVIATIONS = 5.0
_LEAST, _LEAST_DEGREES = 0.02, 0.5
"""Metres and degrees by which matches and tracker may differ, however sure both are."""
_SOONER = 4
"""The next check comes after a quarter of the time if the last one did not confirm the pose."""


@dataclass(frozen=True, eq=False)
class _Checked:
    """What matches said of a pose that was reported."""

    attempt: Attempt
    cam_from_world: Float64Array
    covariance: Float64Array
    tolerance_unit: float


class Check:
    """Checks frames in the background, one at a time."""

    def __init__(self, localizer: Localizer, trust: TrustSettings) -> None:
        self._localizer = localizer
        self._trust = trust
        self._errand: Errand[_Checked] = Errand("gscpe-tracker-check")
        self._due = trust.check_frames
        self._unconfirmed = 0

    def forget(self, index: int) -> None:
        """The localizer has just said where the camera is."""
        self._errand.forget()
        self._due = index + self._trust.check_frames
        self._unconfirmed = 0

    def begin(
        self,
        frame: Frame,
        image: UInt8Array,
        camera: Camera,
        followed: Followed,
        covariance: Float64Array,
    ) -> None:
        """Checks this frame, if it is time."""
        if self._errand.under_way or frame.index < self._due:
            return
        copied, pose = image.copy(), followed.cam_from_world
        unit = followed.anchor.tolerance_unit
        self._errand.begin(
            lambda: _Checked(self._localizer.match_at(copied, camera, pose), pose, covariance, unit)
        )

    def contradiction(self, index: int) -> str | None:
        """Why the pose cannot be right, as far as the last check says; None while it may be."""
        fetched = self._errand.fetch()
        if fetched is None:
            return None
        (checked,) = fetched
        self._due = index + self._trust.check_frames
        if checked.attempt.doubt is not None:
            self._unconfirmed += 1
            self._due = index + max(1, self._trust.check_frames // _SOONER)
            if self._unconfirmed <= self._trust.max_unconfirmed:
                return None
            return f"matches with the map do not confirm the pose ({checked.attempt.doubt})"
        self._unconfirmed = 0
        return _contradiction(checked, self._localizer)

    def close(self) -> None:
        self._errand.close()


def _contradiction(checked: _Checked, localizer: Localizer) -> str | None:
    coarse = checked.attempt.coarse
    assert coarse is not None and coarse.cam_from_world is not None
    shift = pose_difference(coarse.cam_from_world, checked.cam_from_world)
    both = (
        checked.covariance
        if coarse.covariance is None
        else (checked.covariance + coarse.covariance)
    )
    sigma, turn = (float(np.sqrt(np.trace(part))) for part in (both[:3, :3], both[3:, 3:]))
    longest = max(_DEVIATIONS * sigma, _LEAST / checked.tolerance_unit)
    widest = max(_DEVIATIONS * np.degrees(turn), _LEAST_DEGREES)
    if shift.distance <= longest and shift.degrees <= widest:
        return None
    frame = localizer.map.frame
    return (
        "matches with the map contradict the pose by "
        f"{frame.length_text(shift.distance * frame.scale)} and {shift.degrees:.2f} degrees"
    )
