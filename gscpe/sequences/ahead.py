# SPDX-License-Identifier: Apache-2.0
"""Frames that are read and decoded in a thread, while others are worked on."""

from __future__ import annotations

import threading
from collections import deque
from typing import Iterator

from gscpe.closing import Closing
from gscpe.sequences.frame import Frame, Frames

_DEPTH = 8
_LOOK_UP = 0.2  # seconds; where waiting cannot be interrupted (Windows), Ctrl-C waits so long
_PATIENCE = 5.0  # seconds that a thread has to end; a camera may hang in its driver


class ReadAhead(Closing):
    """Iterates over frames that a thread reads. Of a live source, only the newest frame is kept,
    and those that nobody took in time are dropped.

    Args:
        frames: to read.
        depth: how many are read ahead, at most.

    Attributes:
        dropped: frames of a live source that were not taken.
    """

    def __init__(self, frames: Frames, depth: int = _DEPTH) -> None:
        self._frames = frames
        self._depth = depth
        self.dropped = 0
        self._waiting: deque[Frame] = deque()
        self._changed = threading.Condition()
        self._ended = self._closed = False
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._read, name="gscpe frames", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        try:
            for frame in self._frames:
                if not self._offer(frame):
                    return
        except BaseException as error:  # raised again where frames are asked for
            self._error = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _offer(self, frame: Frame) -> bool:
        """Whether more is wanted."""
        with self._changed:
            if self._frames.live:
                self.dropped += len(self._waiting)
                self._waiting.clear()
            while len(self._waiting) >= self._depth and not self._closed:
                self._changed.wait()
            self._waiting.append(frame)
            self._changed.notify_all()
            return not self._closed

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __next__(self) -> Frame:
        """The next frame; raises what the source raised, once its frames are used up."""
        with self._changed:
            while not self._waiting and not self._ended:
                self._changed.wait(_LOOK_UP)
            if self._waiting:
                frame = self._waiting.popleft()
                self._changed.notify_all()
                return frame
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        raise StopIteration

    def close(self) -> None:
        """Ends the thread."""
        with self._changed:
            self._closed = True
            self._waiting.clear()
            self._changed.notify_all()
        self._thread.join(_PATIENCE)
