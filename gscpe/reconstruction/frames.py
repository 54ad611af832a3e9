# SPDX-License-Identifier: Apache-2.0
"""Frames of a video that are worth having: evenly along the way, and the sharpest there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Iterator, Sequence

import cv2
import numpy as np
from tqdm import tqdm

from gscpe.arrays import UInt8Array
from gscpe.errors import ReconstructionError, SequenceError
from gscpe.reconstruction.sharpness import sharpness
from gscpe.sequences.video import OpenedVideo

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
    with _opened(path) as video:
        every = max(1, round(video.frames_a_second / _A_SECOND))
        bar = tqdm(
            desc=f"watching {path.name}", total=video.length, unit="frame", disable=not progress
        )
        with bar:
            for encoded in video:
                bar.update()
                if encoded.number % every:
                    continue
                frame = encoded.decode_bgr()
                if frame is None:
                    continue
                small = _small_grey(frame)
                # From a frame a little back: a hand that shakes gets nowhere.
                moved = 0.0 if before is None else _motion(before, small)
                watched.append(WatchedFrame(encoded.number, way + moved, sharpness(small)))
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
    with _opened(path) as video:
        for encoded in video:
            if encoded.number in wanted:
                frame = encoded.decode_bgr()
                if frame is not None:
                    yield encoded.number, np.asarray(frame[:, :, ::-1])
                wanted.discard(encoded.number)
                if not wanted:
                    return


def _opened(path: Path) -> OpenedVideo:
    """Raises ReconstructionError where it cannot be opened."""
    try:
        return OpenedVideo(path)
    except SequenceError as error:
        raise ReconstructionError(str(error)) from error


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
