# SPDX-License-Identifier: Apache-2.0
"""A frame with its time, and what all sources of frames have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Iterator

import numpy as np

from gscpe.arrays import UInt8Array, short_repr
from gscpe.errors import SequenceError
from gscpe.geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture of a sequence.

    Attributes:
        name: of the photo; ``video/000123.jpg`` of a video, as ``gscpe make-map`` names its
            frames; the time in seconds, of a bag or a camera device.
        time: seconds, from any moment; None where the source does not say.
        image: (H, W, 3) uint8 RGB, as :func:`gscpe.read_image` has it; None where this frame
            cannot be read.
        camera: that took it.
        trouble: why there is no image; else None.
        stamp: for TUM's trajectories: the time, as it can be read back exactly; without a time,
            the number that the photo is named by, or else its position, from 0.
    """

    name: str
    time: float | None
    image: UInt8Array | None
    camera: Camera
    trouble: str | None = None
    stamp: str = ""

    def __repr__(self) -> str:
        return short_repr(self)


class Frames(ABC):
    """Frames in the order of time; iterate over it, as often as needed unless it is live.

    A frame that cannot be read comes without an image; what spoils the whole source is raised.

    Attributes:
        description: what is read, for people.
        length: number of frames; None where it is not known before. Of some videos it is a guess.
        live: whether frames come when they want, and are gone then.
        trouble: after the iteration, why it ended before its time; else None.
    """

    description: str
    length: int | None = None
    live: bool = False
    trouble: str | None = None

    @abstractmethod
    def __iter__(self) -> Iterator[Frame]:
        """The frames.

        Raises:
            SequenceError: the source cannot be read any more, or time runs backwards.
        """


class InOrder(Frames):
    """Frames whose times are checked, or replaced by those of an even rate.

    Args:
        frames: of any source.
        rate: frames a second that take the place of their own times; None: these are kept.
    """

    def __init__(self, frames: Frames, rate: float | None = None) -> None:
        self._frames = frames
        self._rate = rate
        self.description, self.length, self.live = frames.description, frames.length, frames.live

    def __iter__(self) -> Iterator[Frame]:
        before: Frame | None = None
        self.trouble = None
        for number, read in enumerate(self._frames):
            time = read.time if self._rate is None else round(number / self._rate, 9)
            stamp = (read.stamp or str(number)) if time is None else stamp_text(time)
            frame = replace(read, time=time, stamp=stamp)
            _check_time(before, frame)
            before = frame
            yield frame
        self.trouble = self._frames.trouble


def stamp_text(seconds: float) -> str:
    """A time as text, as short as it can be read back exactly, never with an exponent."""
    return np.format_float_positional(seconds, trim="-")


def _check_time(before: Frame | None, frame: Frame) -> None:
    if frame.time is None:
        return
    if not np.isfinite(frame.time):
        raise SequenceError(f"the time of frame {frame.name} is {frame.time}, not a number")
    if before is not None and before.time is not None and frame.time <= before.time:
        back = before.time - frame.time
        how = f"{back:.3g} s before" if back else "the same as"
        raise SequenceError(
            f"time does not run forward: that of frame {frame.name} is {how} that of "
            f"{before.name}. Frames must be in the order of time; a rate (--rate HZ) takes the "
            "place of their times"
        )
