# SPDX-License-Identifier: Apache-2.0
"""Clips whose frames are spoilt, and whether the tracker says so (tools/bench_tracking.py)."""

from __future__ import annotations

from typing import Callable, Sequence

import cv2
import numpy as np
import skimage.data
from _common import table
from changed_photos import exposed, motion_blurred, noisy

from gscpe import Camera, Localizer, Tracker, TrackingSettings, pose_difference
from gscpe.arrays import Float64Array, UInt8Array
from gscpe.evaluation.metrics import expected_error

Clip = Sequence[tuple[UInt8Array, Camera, Float64Array]]

_FIRST, _LAST = 5, 13
"""Frames of a clip that are spoilt; before and after it is as it was."""
_SIGMAS = 5.0


def _foreign(image: UInt8Array) -> UInt8Array:
    size = image.shape[1], image.shape[0]
    return np.asarray(cv2.resize(skimage.data.coffee(), size), dtype=np.uint8)


def _hand(share: float) -> Callable[[UInt8Array], UInt8Array]:
    """A smooth brown surface before so much of the lens, from the right."""

    def change(image: UInt8Array) -> UInt8Array:
        covered = image.copy()
        begin = round(image.shape[1] * (1.0 - share))
        rows = np.linspace(0.8, 1.2, image.shape[0])[:, None, None]
        covered[:, begin:] = np.asarray(rows * np.array([120, 85, 70]), dtype=np.uint8)
        return covered

    return change


def _mirrored(image: UInt8Array) -> UInt8Array:
    return np.ascontiguousarray(image[:, ::-1])


KINDS: dict[str, Callable[[UInt8Array], UInt8Array]] = {
    "black": np.zeros_like,
    "lights off": lambda image: noisy(exposed(image, 0.05), 3.0),
    "a third of the light": lambda image: noisy(exposed(image, 0.33), 3.0),
    "overexposed twice": lambda image: exposed(image, 2.0),
    "moved by 9 px in the exposure": lambda image: motion_blurred(image, 9),
    "moved by 25 px": lambda image: motion_blurred(image, 25),
    "moved by 61 px": lambda image: motion_blurred(image, 61),
    "out of focus": lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), 8.0), np.uint8),
    "another place": _foreign,
    "mirrored": _mirrored,
    "a quarter covered": _hand(0.25),
    "half covered": _hand(0.5),
    "three quarters covered": _hand(0.75),
}

ALL_KINDS = (*KINDS, "jump to the next clip")


def disturb(localizer: Localizer, clips: Sequence[Clip], kinds: Sequence[str] = ALL_KINDS) -> None:
    """Prints, for each kind, what became of the spoilt frames and of those after."""
    table(
        (
            *("frames 5 to 13", "tracked", "relocalized", "lost"),
            *("worst error of those with a pose", "worst, in deviations"),
            *(f"beyond {_SIGMAS:.0f}", "frames after", "... with a pose"),
        ),
        (_row(localizer, name, KINDS.get(name), clips) for name in kinds),
    )


def _row(
    localizer: Localizer,
    name: str,
    change: Callable[[UInt8Array], UInt8Array] | None,
    clips: Sequence[Clip],
) -> tuple[str, ...]:
    unit = localizer.map.metres_per_unit or 1.0
    statuses: list[str] = []
    worst, worst_sigmas, beyond, after, found = 0.0, 0.0, 0, 0, 0
    for number, clip in enumerate(clips):
        other = clips[(number + 1) % len(clips)]
        with Tracker(localizer, TrackingSettings(wait=True)) as tracker:
            for i, view in enumerate(clip):
                spoilt = _FIRST <= i <= _LAST
                image, camera, truth = other[i] if spoilt and change is None else view
                seen = change(image) if spoilt and change is not None else image
                result = tracker.track(seen, camera)
                if spoilt:
                    statuses.append(result.status)
                elif i > _LAST:
                    after += 1
                    found += result.status != "lost"
                if i == 0 or result.cam_from_world is None or result.covariance is None:
                    continue
                error = pose_difference(result.cam_from_world, truth)
                sigma = expected_error(result.covariance)
                off = max(error.distance / sigma.distance, error.degrees / sigma.degrees)
                beyond += off > _SIGMAS
                if spoilt:
                    worst = max(worst, 100.0 * unit * error.distance)
                    worst_sigmas = max(worst_sigmas, off)
    counts = [statuses.count(status) for status in ("tracking", "relocalized", "lost")]
    return (
        *(name, *map(str, counts), f"{worst:.2f} cm" if worst else "", f"{worst_sigmas:.1f}"),
        *(str(beyond), str(after), str(found)),
    )
