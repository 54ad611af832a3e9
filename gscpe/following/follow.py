# SPDX-License-Identifier: Apache-2.0
"""A tracker is given the frames of a sequence, one after the other, as they come."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from tqdm import tqdm

from gscpe.arrays import UInt8Array
from gscpe.errors import SettingsError
from gscpe.following.odometry import Odometry
from gscpe.geometry.camera import Camera
from gscpe.sequences import Clock, Frame, Frames, InRealTime, ReadAhead
from gscpe.tracking import Motion, TrackingResult


class Tracks(Protocol):
    """What :class:`gscpe.Tracker` does."""

    def track(
        self,
        image: UInt8Array,
        camera: Camera,
        time: float | None = None,
        motion: Motion | None = None,
    ) -> TrackingResult: ...


class Observes(Protocol):
    """Who is told of each frame."""

    def add(self, frame: Frame, result: TrackingResult | None) -> None: ...


@dataclass
class Tally:
    """How it went; it grows frame by frame, so that it is right after an interruption too.

    Attributes:
        counts: frames by status: tracking, relocalized, lost, and failed, those that could not be
            read.
        dropped: frames that came while the tracker was busy.
        seconds: that each frame took in the tracker.
        without_odometry: frames whose motion the odometry does not know, where there is one.
    """

    counts: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("tracking", "relocalized", "lost", "failed"), 0)
    )
    dropped: int = 0
    seconds: list[float] = field(default_factory=list)
    without_odometry: int = 0

    @property
    def frames(self) -> int:
        """That were looked at."""
        return sum(self.counts.values())

    @property
    def posed(self) -> int:
        """Frames with a pose."""
        return self.counts["tracking"] + self.counts["relocalized"]

    def __str__(self) -> str:
        counts = self.counts
        parts = [
            f"{counts['tracking']} tracked",
            f"{counts['relocalized']} relocalized",
            f"{counts['lost']} lost",
            f"{self.dropped} dropped",
        ]
        if counts["failed"]:
            parts.append(f"{counts['failed']} unreadable")
        text = f"{self.frames} frames: {', '.join(parts)}"
        if sum(self.seconds) > 0:
            milliseconds = 1000.0 * np.asarray(self.seconds)
            text += (
                f"; {1000.0 / milliseconds.mean():.1f} frames a second, median "
                f"{np.median(milliseconds):.0f} ms, worst {milliseconds.max():.0f} ms"
            )
        return text


def follow(
    tracker: Tracks,
    frames: Frames,
    tally: Tally,
    observers: list[Observes],
    odometry: Odometry | None = None,
    real_time: bool = False,
    clock: Clock | None = None,
    progress: bool = False,
) -> None:
    """Tracks all frames. They are read and decoded in a thread of their own.

    Args:
        tracker: is not closed.
        frames: of any source.
        tally: to count in.
        observers: are told of each frame, in this thread, between the frames.
        odometry: motions between frames.
        real_time: recorded frames come at their times, and those that the tracker has no time for
            are dropped. Of a live source, that is always so.
        clock: of the real time.
        progress: show a bar.

    Raises:
        SequenceError: the source cannot be read any more.
        SettingsError: ``real_time`` or odometry, and frames without times.
        GscpeError: what tracker and observers raise.
    """
    before: float | None = None
    with (
        ReadAhead(frames) as ahead,
        tqdm(total=frames.length, unit="frame", disable=not (progress and sys.stderr)) as bar,
    ):
        paced = InRealTime(ahead, clock) if real_time and not frames.live else ahead
        for frame in paced:
            result = None
            if frame.image is not None:
                motion = _motion(odometry, before, frame, tally)
                began = time.perf_counter()
                result = tracker.track(frame.image, frame.camera, frame.time, motion)
                tally.seconds.append(time.perf_counter() - began)
                before = frame.time
            tally.counts["failed" if result is None else result.status] += 1
            for observer in observers:
                observer.add(frame, result)
            bar.update(1 + paced.dropped - tally.dropped)
            bar.set_postfix_str(f"{tally.posed} with a pose", refresh=False)
            tally.dropped = paced.dropped
        tally.dropped = paced.dropped


def _motion(
    odometry: Odometry | None, before: float | None, frame: Frame, tally: Tally
) -> Motion | None:
    if odometry is None:
        return None
    if frame.time is None:
        raise SettingsError(
            f"frame {frame.name} has no time, so that odometry does not help: give --times FILE, "
            "or --rate HZ"
        )
    if before is None:
        return None
    motion = odometry.motion(before, frame.time)
    tally.without_odometry += motion is None
    return motion
