# SPDX-License-Identifier: Apache-2.0
"""The camera's way: what is known of it, and the anchors around it."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.localization import LocalizationResult, Localizer
from gscpe.tracking.anchors import Anchor, make_anchor, nearest
from gscpe.tracking.background import Errand
from gscpe.tracking.between import aligned_between
from gscpe.tracking.carry import Carried
from gscpe.tracking.check import Check
from gscpe.tracking.follow import (
    Followed,
    Judge,
    covariance_of,
    doubt_about_picture,
    doubt_about_sigmas,
    follow,
)
from gscpe.tracking.frames import Frame
from gscpe.tracking.motion import MotionState, Prediction
from gscpe.tracking.result import TrackingResult, TrackingStatus, lost
from gscpe.tracking.settings import TrackingSettings

_LONGEST_UNSEEN = 30
"""Frames after which nothing is expected of the motion before."""
_FIRST_LEAD = 4.0
"""Frames that an anchor takes, before one was measured."""
_BEYOND = 0.75
"""An anchor is asked for so much of its reach beyond where it will be needed first."""
_MOST_FRAMES_AHEAD = 10.0
_FAR = 2.0
"""Times ``anchor_pixels`` beyond which a frame that may wait does so, for a moment."""
_SHORT_WAIT = 0.003
"""Seconds: with it, 95 of 100 frames are done before the next one of a camera would come."""
_CLOSER = 2
"""Renders of its own, at most, that a frame may wait for before it is lost."""
_NEARLY = 0.3
"""Correlation with the map above which an alignment may have ended near the pose."""
_NEWEST = 0.2
"""Weight of the last frame's time in their running mean."""


class Course:
    """Follows a camera that was found, until it is lost.

    Attributes:
        state: what is known of the camera's motion; None where nothing is.
    """

    def __init__(self, localizer: Localizer, settings: TrackingSettings) -> None:
        self.state: MotionState | None = None
        self._localizer = localizer
        self._settings = settings
        self._anchors: list[Anchor] = []
        self._next: Errand[Anchor | None] = Errand("gscpe-tracker-anchors")
        self._check = Check(localizer, settings.trust)
        self._judge = Judge(settings)
        self._light = 1.0, 0.0
        self._lost = 0
        self._elsewhere = False
        self._found_anew = False
        self._lead = _FIRST_LEAD
        self._interval: float | None = None

    @property
    def is_followed(self) -> bool:
        """Whether the last frame had a pose."""
        return self.state is not None and self._lost == 0

    @property
    def wants_search(self) -> bool:
        """Whether the localizer should look for the camera: after some patience, and at once where
        a frame that may wait looks like another place, as after a jump."""
        patience = 1 if self._settings.wait and self._elsewhere else self._settings.patience
        return self.state is None or self._lost >= patience

    def begin(self, found: Carried) -> None:
        """A camera that was found at the frame before the next one."""
        self._start_at(found.state, found.anchor)

    def begin_at(self, result: LocalizationResult, anchor: Anchor, frame: Frame) -> TrackingResult:
        """A camera that was found at this frame."""
        assert result.cam_from_world is not None and result.aligned is not None
        self._start_at(MotionState.at_rest(result.cam_from_world, frame.time), anchor)
        self._found_anew = False
        agreement = result.aligned.agreement
        pose, covariance = result.cam_from_world, result.covariance
        return TrackingResult("relocalized", None, pose, covariance, 0, agreement, 0.0)

    def _start_at(self, state: MotionState, anchor: Anchor) -> None:
        self.state, self._anchors = state, [anchor]
        self._next.forget()
        self._check.forget(anchor.asked)
        self._light, self._lost, self._found_anew = (1.0, 0.0), 0, True

    def follow(self, frame: Frame, image: UInt8Array, camera: Camera) -> TrackingResult:
        """The next frame."""
        self._take_anchor(frame.index)
        contradiction = self._check.contradiction(frame.index)
        if contradiction is not None:
            self.state = None
            return lost(contradiction)
        if self.state is None:
            return lost("the camera is lost")
        if len(frame.levels) != len(self._anchors[0].prepared.levels):
            self.state = None
            return lost("the frames have another size than before")
        self._elsewhere = False
        elapsed = frame.time - self.state.time
        expected = self.state.predicted(frame.time, frame.motion)
        outcome = frame.trouble() or self._aligned(frame, expected)
        if isinstance(outcome, str):
            self._lost += 1
            self.state = self.state.not_seen(frame.time, frame.motion)
            if self.state.unseen > _LONGEST_UNSEEN:
                self.state = None
            return lost(outcome)
        followed, covariance = outcome
        if self._settings.between:
            followed = aligned_between(followed, frame, self._anchors, self._settings)
        status = self._accept(followed, frame, elapsed)
        self._check.begin(frame, image, camera, followed, covariance)
        return TrackingResult(
            status,
            None,
            followed.cam_from_world,
            covariance,
            frame.index - followed.anchor.asked,
            followed.agreement.correlation,
            0.0,
        )

    def _aligned(self, frame: Frame, expected: Prediction) -> tuple[Followed, Float64Array] | str:
        """The frame aligned, and its covariance; or why it cannot be trusted."""
        anchor = self._anchor_for(expected, frame)
        reason, nearly = None, None
        for wide in (False, True):
            found = follow(frame, anchor, expected, self._light, self._settings, wide)
            outcome = self._judged(found, frame, wide or self._lost > 0)
            if not isinstance(outcome, str):
                return outcome
            reason = reason or outcome
            nearly = _more_alike(nearly, found)
        assert reason is not None
        closer = self._aligned_closer(frame, expected, nearly)
        if closer is not None:
            return closer
        least = self._settings.trust.min_agreement
        self._elsewhere = nearly is None or not nearly.agreement.correlation >= least
        return reason

    def _aligned_closer(
        self, frame: Frame, expected: Prediction, nearly: Followed | None
    ) -> tuple[Followed, Float64Array] | None:
        """The frame aligned with a render from where the last alignment ended, or from where the
        camera is expected; None where that does not help either. A frame that may not wait leaves
        the render to those that follow.

        A blurred frame far from its anchor comes near its pose, but slowly; and the gradients of
        two pictures that are a few pixels apart have nothing in common.
        """
        for _ in range(_CLOSER):
            if nearly is not None and nearly.agreement.correlation >= _NEARLY:
                pose = nearly.cam_from_world
            elif nearest(self._anchors, expected.cam_from_world)[1] > self._settings.anchor_pixels:
                pose = expected.cam_from_world
            else:
                return None
            if not self._settings.wait:
                if not self._next.under_way:
                    self._ask(pose, frame)
                return None
            self._next.forget()
            self._ask(pose, frame)
            self._take_anchor(frame.index, patience=None)
            anchor = nearest(self._anchors, pose)[0]
            found = follow(frame, anchor, expected, self._light, self._settings, begin_at=pose)
            outcome = self._judged(found, frame, True)
            if not isinstance(outcome, str):
                return outcome
            nearly = None if isinstance(found, str) else found
        return None

    def _judged(
        self, found: Followed | str, frame: Frame, sure: bool
    ) -> tuple[Followed, Float64Array] | str:
        """An alignment and its covariance, or why it cannot be trusted."""
        trust = self._settings.trust
        if isinstance(found, str):
            return found
        doubt = doubt_about_picture(found, trust, sure)
        if doubt is not None:
            return doubt
        covariance = self._judge.covariance(found, frame)
        map_frame = self._localizer.map.frame
        doubt = doubt_about_sigmas(covariance, found.anchor, trust, map_frame)
        if doubt is not None:  # few pixels of a blurred frame say less than all of them
            covariance = covariance_of(found, frame, self._settings, all_pixels=True)
            doubt = doubt_about_sigmas(covariance, found.anchor, trust, map_frame)
        return (found, covariance) if doubt is None else doubt

    def _accept(self, followed: Followed, frame: Frame, elapsed: float) -> TrackingStatus:
        """Goes on from this frame, and asks for the next anchor if it is time."""
        assert self.state is not None
        pose = followed.cam_from_world
        self.state = self.state.seen(pose, frame.time, followed.surprise_pixels)
        self._light = followed.alignment.gain, followed.alignment.bias
        status: TrackingStatus = "relocalized" if self._found_anew or self._lost else "tracking"
        self._lost, self._found_anew = 0, False
        before = elapsed if self._interval is None else self._interval
        self._interval = before + _NEWEST * (elapsed - before)
        if not self._next.under_way:
            self._plan(followed, frame)
        return status

    def _plan(self, followed: Followed, frame: Frame) -> None:
        """Asks for an anchor where the camera will be once it is there, if all that there are will
        be too far then."""
        assert self.state is not None
        assert self._interval is not None
        step, pose = self.state.velocity * self._interval, followed.cam_from_world
        ready = se3.exp(self._lead * step) @ pose
        reach = self._settings.anchor_pixels
        if nearest(self._anchors, ready)[1] <= reach:
            return
        motion = followed.anchor.template.motion
        speed = float(np.sqrt(step @ motion @ step))
        # In the middle of the frames that it will serve, until the one after it is ready.
        middle = max(_BEYOND * reach / max(speed, 0.1), 0.5 * self._lead)
        ahead = min(self._lead + middle, _MOST_FRAMES_AHEAD)
        self._ask(se3.exp(ahead * step) @ pose, frame)

    def _ask(self, cam_from_world: Float64Array, frame: Frame) -> None:
        """Asks for an anchor."""
        scale, settings = self._localizer.map.frame.scale, self._settings
        self._next.begin(
            lambda: make_anchor(
                self._localizer, frame.camera, cam_from_world, settings, scale, frame.index
            )
        )

    def _take_anchor(self, index: int, patience: float | None = 0.0) -> None:
        """Takes the anchor that was asked for, if it is there within so many seconds."""
        fetched = self._next.fetch(patience)
        if fetched is None:
            return
        (anchor,) = fetched
        if anchor is not None:
            took = float(index - anchor.asked)
            self._lead += 0.5 * (took - self._lead)
            self._anchors = [*self._anchors, anchor][-self._settings.anchors :]

    def _anchor_for(self, expected: Prediction, frame: Frame) -> Anchor:
        """The nearest anchor; waits for a nearer one if it is far, and waiting is allowed."""
        pose, settings = expected.cam_from_world, self._settings
        anchor, distance = nearest(self._anchors, pose)
        if not settings.wait or distance <= _FAR * settings.anchor_pixels:
            return anchor
        if distance > settings.farthest_pixels:
            if not self._next.under_way:
                self._ask(pose, frame)
            self._take_anchor(frame.index, patience=None)
        else:
            self._take_anchor(frame.index, patience=_SHORT_WAIT)
        return nearest(self._anchors, pose)[0]

    def close(self) -> None:
        self._next.close()
        self._check.close()


def _more_alike(nearly: Followed | None, found: Followed | str) -> Followed | None:
    """Of two alignments, the one whose frame looks more like the map; None if both failed."""
    if isinstance(found, str):
        return nearly
    if nearly is None or found.agreement.correlation > nearly.agreement.correlation:
        return found
    return nearly
