# SPDX-License-Identifier: Apache-2.0
"""Looks for a camera that is lost, with the localizer, beside the frames or while they wait."""

from __future__ import annotations

import threading
from typing import Callable

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.geometry.camera import Camera
from gscpe.localization import LocalizationResult, Localizer, PosePrior
from gscpe.tracking.anchors import Anchor, make_anchor
from gscpe.tracking.background import Errand
from gscpe.tracking.carry import Carried, KeptFrames, carry_forward
from gscpe.tracking.frames import Frame
from gscpe.tracking.motion import MotionState
from gscpe.tracking.settings import TrackingSettings

NOT_FOUND_YET = "the camera has not been found yet: the localizer is at work"
_LONGEST_PAUSE = 15
"""Frames, at most, between two searches that frames wait for."""
NOT_LOOKED_FOR = "it was not looked for with the localizer, as frames before were in vain"
_PRIOR_SIGMA, _PRIOR_DEGREES = 0.3, 15.0
"""Metres and degrees by which a camera that was lost a moment ago may be elsewhere."""
_A_MOMENT = 15


class Search:
    """Asks the localizer, one frame at a time.

    Attributes:
        last_reason: why the camera is not known, as far as the search can tell.
    """

    def __init__(self, localizer: Localizer, settings: TrackingSettings) -> None:
        self._localizer = localizer
        self._settings = settings
        self._errand: Errand[Carried | str] = Errand("gscpe-tracker-search")
        self._kept = KeptFrames(settings.kept_frames)
        self._stop = threading.Event()
        self._first: Frame | None = None
        self._pause = 0
        self._left = 0
        self.last_reason: str | None = None

    @property
    def under_way(self) -> bool:
        """Whether frames are to be kept."""
        return self._errand.under_way

    def begin(
        self, frame: Frame, image: UInt8Array, camera: Camera, state: MotionState | None
    ) -> None:
        """Looks for the camera of a frame in the background."""
        self._kept, self._stop = KeptFrames(self._settings.kept_frames), threading.Event()
        copied, kept, stop, prior = image.copy(), self._kept, self._stop, self._prior(state)
        settings, self._first = self._settings, frame
        self.last_reason = self.last_reason or NOT_FOUND_YET

        def work() -> Carried | str:
            if stop.is_set():
                return NOT_FOUND_YET
            result = self._localizer.localize(copied, camera, prior)
            found = self._first_anchor(result, frame)
            if isinstance(found, str):
                return found
            return carry_forward(found, kept, self._render_like(frame), settings, stop.is_set)

        self._errand.begin(work)

    def keep(self, frame: Frame) -> None:
        """A frame since then."""
        self._kept.add(frame)

    def found(self) -> Carried | None:
        """The camera at the last frame that was kept; once."""
        fetched = self._errand.fetch()
        if fetched is None:
            return None
        (answer,) = fetched
        if isinstance(answer, str):
            self.last_reason = answer
            return None
        self.last_reason = None
        # Frames that were kept after the other thread had looked for the last time: hardly any.
        assert self._first is not None
        return carry_forward(answer, self._kept, self._render_like(self._first), self._settings)

    def forget(self) -> None:
        """The camera was found by other means, or never lost."""
        if self._errand.under_way:
            self._stop.set()
            self._errand.forget()
        self.last_reason = None
        self._pause = self._left = 0

    def is_due(self) -> bool:
        """Whether a frame may wait for :meth:`at_once`: seldom, where the last ones did in vain."""
        self._left -= 1
        return self._left < 0

    def at_once(
        self, frame: Frame, image: UInt8Array, camera: Camera, state: MotionState | None
    ) -> tuple[LocalizationResult, Anchor] | str:
        """The localizer's answer for this frame, and an anchor there; or why there is none."""
        result = self._localizer.localize(image, camera, self._prior(state))
        found = self._first_anchor(result, frame)
        if isinstance(found, str):
            # One bad frame says nothing of the next; several do.
            self._left = self._pause
            self._pause = min(2 * self._pause + 1, _LONGEST_PAUSE)
            return found
        self._pause = self._left = 0
        return result, found.anchor

    def _first_anchor(self, result: LocalizationResult, frame: Frame) -> Carried | str:
        if result.cam_from_world is None:
            return result.reason or "the localizer does not find the camera"
        anchor = self._render_like(frame)(result.cam_from_world)
        if anchor is None:
            return "too little of the map is visible where the localizer found the camera"
        return Carried(MotionState.at_rest(result.cam_from_world, frame.time), anchor)

    def _render_like(self, frame: Frame) -> Callable[[Float64Array], Anchor | None]:
        """Makes anchors for frames of the same camera."""
        scale, camera, index = self._localizer.map.frame.scale, frame.camera, frame.index
        return lambda pose: make_anchor(self._localizer, camera, pose, self._settings, scale, index)

    def _prior(self, state: MotionState | None) -> PosePrior | None:
        if state is None or state.unseen > _A_MOMENT:
            return None
        sigma = _PRIOR_SIGMA / self._localizer.map.frame.scale
        return PosePrior(state.cam_from_world, sigma, _PRIOR_DEGREES)

    def close(self) -> None:
        self._stop.set()
        self._errand.close()
