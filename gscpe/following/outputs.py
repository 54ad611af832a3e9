# SPDX-License-Identifier: Apache-2.0
"""What was found, a line a frame, in files that are right whenever the program ends."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, TextIO

from gscpe.batch import keep_a_copy
from gscpe.closing import Closing
from gscpe.errors import OutputError
from gscpe.interrupts import interrupts_later
from gscpe.photos.photo_name import quoted_name
from gscpe.poses.hloc import format_pose
from gscpe.poses.tum import tum_line
from gscpe.sequences import Frame
from gscpe.tracking import TrackingResult


class TrackFiles(Closing):
    """Files that get a line a frame at once, so that nothing is lost when the program is killed.

    Files of an earlier run are kept, with the ending ``.bak``.

    Args:
        trajectory: TUM's form, ``time tx ty tz qx qy qz qw``, camera to world; frames without a
            pose are not in it.
        poses: hloc's form, ``name qw qx qy qz tx ty tz``, world to camera; None: not written.
        details: JSON, all frames, see :func:`track_details`; None: not written.

    Raises:
        OutputError: one of them cannot be written.
    """

    def __init__(
        self, trajectory: str | Path, poses: str | Path | None, details: str | Path | None
    ) -> None:
        self._open: list[TextIO] = []
        self._trajectory = self._opened(trajectory)
        self._poses = None if poses is None else self._opened(poses)
        self._details = None if details is None else self._opened(details)

    def _opened(self, path: str | Path) -> TextIO:
        path = Path(path)
        keep_a_copy(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("w", buffering=1, encoding="utf-8", errors="surrogateescape")
        except OSError as error:
            self.close()
            raise OutputError(f"{path} cannot be written: {error.strerror}") from error
        self._open.append(file)
        return file

    def add(self, frame: Frame, result: TrackingResult | None) -> None:
        """Writes a frame's lines; all of them, or none where an interrupt comes before.

        Args:
            frame: with its name and time.
            result: of the tracker; None where the frame could not be read.

        Raises:
            OutputError: they cannot be written; for example, the disk is full.
        """
        with interrupts_later():
            if result is not None and result.cam_from_world is not None:
                _write(self._trajectory, tum_line(frame.stamp, result.cam_from_world))
                pose = format_pose(result.cam_from_world)
                _write(self._poses, f"{quoted_name(frame.name)} {pose}\n")
            _write(self._details, json.dumps(track_details(frame, result)) + "\n")

    def close(self) -> None:
        """Closes the files.

        Raises:
            OutputError: what was still to be written cannot be.
        """
        trouble: OutputError | None = None
        while self._open:
            file = self._open.pop()
            try:
                file.close()
            except OSError as error:
                trouble = _cannot_be_written(file, error)
        if trouble is not None:
            raise trouble


def track_details(frame: Frame, result: TrackingResult | None) -> dict[str, Any]:
    """A frame's result as plain data for JSON (docs/formats.md says what each field is)."""
    details: dict[str, Any] = {
        "name": frame.name,
        "time": frame.time,
        "camera": frame.camera.colmap_text(),
        "status": "failed",
        "reason": frame.trouble,
        "cam_from_world": None,
        "covariance": None,
        "anchor_age": None,
        "agreement": None,
        "milliseconds": None,
    }
    if result is None:
        return details
    pose, covariance, agreement = result.cam_from_world, result.covariance, result.agreement
    return details | {
        "status": result.status,
        "reason": result.reason,
        "cam_from_world": None if pose is None else format_pose(pose),
        "covariance": None if covariance is None else covariance.tolist(),
        "anchor_age": result.anchor_age,
        "agreement": round(agreement, 4) if math.isfinite(agreement) else None,
        "milliseconds": round(result.milliseconds, 3),
    }


def _write(file: TextIO | None, line: str) -> None:
    if file is None:
        return
    try:
        file.write(line)
    except OSError as error:
        raise _cannot_be_written(file, error) from error


def _cannot_be_written(file: TextIO, error: OSError) -> OutputError:
    return OutputError(f"{file.name} cannot be written: {error.strerror}")
