# SPDX-License-Identifier: Apache-2.0
"""Frames of a video that are worth having: evenly along the way, and the sharpest there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Iterator, Sequence

import cv2
import numpy as np
from tqdm import tqdm

from gscpe.arrays import UInt8Array
from gscpe.errors import ReconstructionError
from gscpe.reconstruction.sharpness import sharpness

_LOOKED_AT = 480  # pixels, longer side, that motion and sharpness are measured on
_A_SECOND = 12.0  # frames that are looked at
_LEAST_STEP = 0.03  # of the picture's width, between two frames that are kept
_LEAST_WAY = 0.15  # of the width, in the whole video
_FOLLOWED = 0.08  # of the width, before motion is measured from another frame
_LOST = 0.25  # of the width: motion where nothing could be followed


@dataclass(frozen=True)
class WatchedFrame:
    """A frame that was looked at.

    Attributes:
        number: in the video, from 0.
        way: motion of the picture up to here, in widths of it.
        sharpness: see :func:`sharpness`.
    """

    number: int
    way: float
    sharpness: float


def choose_frames(watched: Sequence[WatchedFrame], count: int) -> list[WatchedFrame]:
    """The sharpest frame of each of ``count`` equally long pieces of the way; fewer where pieces
    would be so short that neighbours show the same."""
    if not watched:
        return []
    way = max(frame.way for frame in watched)
    pieces = max(1, min(count, int(way / _LEAST_STEP)))
    chosen: list[WatchedFrame] = []
    by_piece: dict[int, list[WatchedFrame]] = {}
    for frame in watched:
        piece = min(int(frame.way / max(way, 1e-9) * pieces), pieces - 1)
        by_piece.setdefault(piece, []).append(frame)
    for piece in sorted(by_piece):
        new = [f for f in by_piece[piece] if not chosen or f.way - chosen[-1].way >= _LEAST_STEP]
        if new:
            chosen.append(max(new, key=lambda frame: frame.sharpness))
    return chosen


def watch(path: Path, progress: bool = False) -> list[WatchedFrame]:
    """Looks through a video: how far the picture has moved, and how sharp it is.

    Raises:
        ReconstructionError: it cannot be decoded, or hardly moves.
    """
    watched: list[WatchedFrame] = []
    before: UInt8Array | None = None
    way = 0.0
    with _Opened(path) as video:
        every = max(1, round(video.frames_a_second / _A_SECOND))
        bar = tqdm(
            desc=f"watching {path.name}", total=video.length, unit="frame", disable=not progress
        )
        with bar:
            for number, decode in video:
                bar.update()
                if number % every:
                    continue
                frame = decode()
                if frame is None:
                    continue
                small = _small_grey(frame)
                # From a frame a little back: a hand that shakes gets nowhere.
                moved = 0.0 if before is None else _motion(before, small)
                watched.append(WatchedFrame(number, way + moved, sharpness(small)))
                if before is None or moved >= _FOLLOWED:
                    before, way = small, way + moved
    if not watched:
        raise ReconstructionError(
            f"{path} cannot be decoded; convert it (ffmpeg -i {path.name} -c:v libx264 out.mp4), "
            "or give a folder of photos"
        )
    longest = max(frame.way for frame in watched)
    if longest < _LEAST_WAY:
        raise ReconstructionError(
            f"{path} hardly moves: the picture shifts by {100 * longest:.0f}% of its width in all "
            "of it. Walk through the place while you film, also sideways"
        )
    return watched


def read_frames(path: Path, numbers: Sequence[int]) -> Iterator[tuple[int, UInt8Array]]:
    """The frames with these numbers, in order, (H, W, 3) RGB; those that cannot be decoded are
    left out."""
    wanted = set(numbers)
    with _Opened(path) as video:
        for number, decode in video:
            if number in wanted:
                frame = decode()
                if frame is not None:
                    yield number, np.asarray(frame[:, :, ::-1])
                wanted.discard(number)
                if not wanted:
                    return


class _Opened:
    """A video; iterates over frame numbers and functions that decode them (BGR), upright."""

    def __init__(self, path: Path) -> None:
        self._capture: Any = cv2.VideoCapture(str(path))
        if not self._capture.isOpened():
            raise ReconstructionError(
                f"{path} cannot be opened as a video; is it damaged? Convert it (ffmpeg -i "
                f"{path.name} -c:v libx264 out.mp4), or give a folder of photos"
            )
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.frames_a_second: float = rate if 1.0 <= rate <= 1000.0 else 30.0
        length = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.length = length if length > 0 else None

    def __enter__(self) -> _Opened:
        return self

    def __exit__(self, *_: object) -> None:
        self._capture.release()

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        number = 0
        while self._capture.grab():
            yield number, self._decode
            number += 1

    def _decode(self) -> UInt8Array | None:
        found, frame = self._capture.retrieve()
        return np.asarray(frame, dtype=np.uint8) if found and frame is not None else None


def _small_grey(frame: UInt8Array) -> UInt8Array:
    grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    scale = _LOOKED_AT / max(grey.shape)
    if scale < 1.0:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(grey, dtype=np.uint8)


def _motion(before: UInt8Array, after: UInt8Array) -> float:
    """Median length by which corners move, in widths of the picture."""
    corners = cv2.goodFeaturesToTrack(before, 200, 0.01, 8)
    if corners is None or len(corners) < 8:
        return 0.0  # nothing to see: a wall, or darkness
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, corners, np.empty_like(corners), winSize=(21, 21), maxLevel=4
    )
    followed = found.ravel() == 1
    if np.count_nonzero(followed) < 0.3 * len(corners):
        return _LOST
    lengths = np.linalg.norm((moved - corners).reshape(-1, 2)[followed], axis=1)
    return float(np.median(lengths) / before.shape[1])
