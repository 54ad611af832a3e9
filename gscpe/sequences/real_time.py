# SPDX-License-Identifier: Apache-2.0
"""Recorded frames as if a camera delivered them now."""

from __future__ import annotations

import time
from typing import Iterator

from gscpe.errors import SettingsError
from gscpe.sequences.frame import Frame


class Clock:
    """The time, and waiting; tests have one of their own."""

    def now(self) -> float:
        """Seconds since any moment."""
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        """Waits."""
        time.sleep(seconds)


class InRealTime:
    """Iterates over frames, each at its time: waits for those that are to come, and drops those
    that a newer one has overtaken while the caller was busy, as a camera with room for one does.

    Args:
        frames: recorded, with times.
        clock: of the real time.

    Attributes:
        dropped: frames that were overtaken.

    Raises:
        SettingsError: a frame has no time.
    """

    def __init__(self, frames: Iterator[Frame], clock: Clock | None = None) -> None:
        self._frames = frames
        self._clock = clock or Clock()
        self.dropped = 0

    def __iter__(self) -> Iterator[Frame]:
        frame = next(self._frames, None)
        if frame is None:
            return
        start = self._clock.now() - _time_of(frame)
        while frame is not None:
            following = next(self._frames, None)
            self._wait_until(start + _time_of(frame))
            while following is not None and start + _time_of(following) <= self._clock.now():
                self.dropped += 1
                frame, following = following, next(self._frames, None)
            yield frame
            frame = following

    def _wait_until(self, moment: float) -> None:
        left = moment - self._clock.now()
        if left > 0:
            self._clock.wait(left)


def _time_of(frame: Frame) -> float:
    if frame.time is None:
        raise SettingsError(
            f"frame {frame.name} has no time, so that nobody knows when it would have come: give "
            "--times FILE, or --rate HZ"
        )
    return frame.time
