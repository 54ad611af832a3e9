# SPDX-License-Identifier: Apache-2.0
"""The localizer's answer is about a frame of a second ago: it is carried forward to this one.

The frames since then were kept, small. They are followed from the answer on, one after the other,
as they would have been if the answer had come at once. Where one shows nothing, the camera is
taken to have moved as was measured, or as before.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, replace
from typing import Callable

from gscpe.arrays import Float64Array
from gscpe.tracking.anchors import Anchor
from gscpe.tracking.follow import doubt_about_picture, follow
from gscpe.tracking.frames import Frame
from gscpe.tracking.motion import Motion, MotionState
from gscpe.tracking.settings import TrackingSettings

_HALVINGS = 2
"""Frames are kept at a quarter of their size."""
_FAR = 48.0
"""Pixels of the frame that the image may have moved from an anchor that small frames follow."""


class KeptFrames:
    """The last frames, small, for another thread to read. At most ``most``: then every second is
    dropped, and its motion is added to the next one's."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._frames: deque[Frame] = deque()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        with self._lock:
            return len(self._frames)

    def add(self, frame: Frame) -> None:
        small = replace(frame, levels=frame.levels[min(_HALVINGS, len(frame.levels) - 1) :])
        with self._lock:
            self._frames.append(small)
            if len(self._frames) > self._most:
                self._frames = deque(_every_second(list(self._frames)))

    def take(self) -> Frame | None:
        """The oldest; None where there is none."""
        with self._lock:
            return self._frames.popleft() if self._frames else None


def _every_second(frames: list[Frame]) -> list[Frame]:
    """The last one is among them."""
    if len(frames) % 2:
        first, frames = frames[:1], frames[1:]
    else:
        first = []
    return first + [
        replace(later, motion=joined(earlier.motion, later.motion))
        for earlier, later in zip(frames[::2], frames[1::2], strict=True)
    ]


def joined(first: Motion | None, second: Motion | None) -> Motion | None:
    """Two motions, one after the other; None where one was not measured."""
    if first is None or second is None:
        return None
    translation = (first.translation_sigma**2 + second.translation_sigma**2) ** 0.5
    rotation = (first.rotation_sigma**2 + second.rotation_sigma**2) ** 0.5
    moved = second.cam_from_previous_cam @ first.cam_from_previous_cam
    return Motion(moved, translation, rotation)


@dataclass(frozen=True, eq=False)
class Carried:
    """A camera that was found and followed.

    Attributes:
        state: of its motion at the last frame that was taken.
        anchor: near it, of the frames' full size.
    """

    state: MotionState
    anchor: Anchor


def carry_forward(
    carried: Carried,
    kept: KeptFrames,
    render: Callable[[Float64Array], Anchor | None],
    settings: TrackingSettings,
    stopped: Callable[[], bool] = lambda: False,
) -> Carried:
    """Follows the kept frames until there is none.

    Args:
        carried: where to begin.
        kept: frames since then; they are taken away.
        render: makes an anchor at a pose.
        settings: of the tracker.
        stopped: whether to give up.
    """
    state, anchor = carried.state, carried.anchor
    small = anchor.smaller(_HALVINGS)
    light = 1.0, 0.0
    while not stopped() and (frame := kept.take()) is not None:
        expected = state.predicted(frame.time, frame.motion)
        if anchor.pixels_to(expected.cam_from_world) > _FAR:
            nearer = render(expected.cam_from_world)
            if nearer is not None:
                anchor, small = nearer, nearer.smaller(_HALVINGS)
        state, light = _one_step(state, frame, small, light, settings)
    return Carried(state, anchor)


def _one_step(
    state: MotionState,
    frame: Frame,
    small: Anchor | None,
    light: tuple[float, float],
    settings: TrackingSettings,
) -> tuple[MotionState, tuple[float, float]]:
    """The state and the light after a frame, whether it shows something or not."""
    if small is not None and frame.trouble() is None:
        expected = state.predicted(frame.time, frame.motion)
        for wide in (False, True):
            found = follow(frame, small, expected, light, settings, wide)
            if not isinstance(found, str) and not doubt_about_picture(found, settings.trust, wide):
                pixels = found.surprise_pixels * 2.0**_HALVINGS
                light = found.alignment.gain, found.alignment.bias
                return state.seen(found.cam_from_world, frame.time, pixels), light
    return state.not_seen(frame.time, frame.motion), light
