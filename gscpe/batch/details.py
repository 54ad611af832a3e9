# SPDX-License-Identifier: Apache-2.0
"""A query's result as plain data, one JSON object a line (docs/formats.md)."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import OutputError
from gscpe.geometry.camera import Camera
from gscpe.given import parse_json
from gscpe.localization import Attempt, LocalizationResult
from gscpe.poses.hloc import format_pose
from gscpe.scene.query_list import Query

_log = logging.getLogger(__name__)

Detail = dict[str, Any]
"""What docs/formats.md lists under "Details"."""

_FIELDS = {"name", "camera", "status", "reason", "cam_from_world", "coarse", "aligned"}


def result_details(query: Query, result: LocalizationResult, photo: str | None = None) -> Detail:
    """A result as plain data for JSON (docs/formats.md says what each field is).

    Args:
        query: the name and the camera.
        result: of its photo.
        photo: fingerprint of the photo's file, where resuming is to compare it.
    """
    coarse, aligned = result.coarse, result.aligned
    return {
        "name": query.name,
        **camera_details(query.camera),
        "status": "localized" if result.localized else "not localized",
        "reason": result.reason,
        "cam_from_world": _pose(result.cam_from_world),
        "started_from": result.started_from,
        "reference": result.reference,
        "orientation": 1 if result.best is None else result.best.orientation,
        "matcher": None if result.best is None else result.best.matcher,
        "hypotheses": len(result.attempts),
        "attempts": [_attempt(attempt) for attempt in result.attempts],
        "coarse": coarse
        and {
            "cam_from_world": _pose(coarse.cam_from_world),
            "matches": coarse.matches,
            "inliers": coarse.inliers,
            "rms_pixels": _number(coarse.rms_pixels),
            "covariance": None if coarse.covariance is None else coarse.covariance.tolist(),
            "intrinsics": coarse.intrinsics
            and {
                "camera": coarse.intrinsics.camera.colmap_text(),
                "change": coarse.intrinsics.change.tolist(),
                "covariance": coarse.intrinsics.covariance.tolist(),
            },
            "rounds": coarse.rounds,
            "converged": coarse.converged,
        },
        "aligned": aligned
        and {
            "cam_from_world": _pose(aligned.cam_from_world),
            "residual": _number(aligned.residual),
            "agreement": _number(aligned.agreement),
            "overlap": _number(aligned.overlap),
            "gain": _number(aligned.gain),
            "bias": _number(aligned.bias),
            "pixels": aligned.pixels,
            "anchors": aligned.anchors,
            "converged": aligned.converged,
        },
        "covariance": None if result.covariance is None else result.covariance.tolist(),
        "seconds": {stage: round(value, 4) for stage, value in result.seconds.items()},
        "photo": photo,
    }


def camera_details(camera: Camera) -> Detail:
    """The fields that say what a photo's camera is, and how well that is known."""
    covariance = camera.covariance_matrix().tolist() if camera.covariance else None
    return {"camera": camera.colmap_text(), "camera_covariance": covariance}


def _attempt(attempt: Attempt) -> dict[str, Any]:
    """What was tried, and why it did not count; ``doubt`` is None for what can be trusted."""
    return {
        "started_from": attempt.start.kind,
        "reference": attempt.start.reference,
        "matcher": attempt.matcher,
        "orientation": attempt.orientation,
        "doubt": attempt.doubt,
    }


def failed_details(query: Query, reason: str) -> Detail:
    """Of a photo that could not be used: the same fields, all empty but for the reason."""
    return {
        "name": query.name,
        **camera_details(query.camera),
        "status": "failed",
        "reason": reason,
        "cam_from_world": None,
        "started_from": None,
        "reference": None,
        "orientation": 1,
        "matcher": None,
        "hypotheses": 0,
        "attempts": [],
        "coarse": None,
        "aligned": None,
        "covariance": None,
        "seconds": {},
        "photo": None,  # it is done again whatever it holds
    }


def read_details(path: str | Path) -> dict[str, Detail]:
    """Details by name; lines that were cut off are left out. Empty when there is no file.

    Raises:
        OutputError: it is not a text file, or cannot be read.
    """
    details: dict[str, Detail] = {}
    path = Path(path)
    try:
        lines = path.read_text().splitlines() if path.exists() else []
    except (OSError, UnicodeDecodeError) as error:
        raise OutputError(f"{path} exists but is not a details file; choose another") from error
    left_out = 0
    for line in lines:
        try:
            detail = parse_json(line)
            complete = detail.keys() >= _FIELDS
        except (ValueError, AttributeError):
            complete = False
        if complete:
            details[str(detail["name"])] = detail
        else:
            left_out += 1
    if left_out:
        _log.warning(
            "%s: %d of %d lines are cut off, or not those of gscpe localize, and do not count",
            *(path, left_out, len(lines)),
        )
    return details


def _pose(cam_from_world: Float64Array | None) -> str | None:
    return None if cam_from_world is None else format_pose(cam_from_world)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
