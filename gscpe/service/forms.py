# SPDX-License-Identifier: Apache-2.0
"""The texts in a request: a camera and an approximate pose, as on the command line or as JSON."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from gscpe.errors import CameraError, PoseError
from gscpe.geometry.camera import Camera
from gscpe.localization import PosePrior
from gscpe.poses.hloc import parse_pose
from gscpe.service.problem import one_line

_MOST = 4000
"""Letters of a text."""


def parse_camera(text: str | None) -> Camera | None:
    """``MODEL,width,height,params...``, or JSON ``{"model", "width", "height", "params"}``; None
    where there is no text.

    Raises:
        CameraError: it has another form, or no camera has such numbers.
    """
    text = (text or "").strip()
    if not text:
        return None
    if len(text) > _MOST:
        raise CameraError(f"a camera's text has at most {_MOST} letters, not {len(text)}")
    if not text.startswith("{"):
        return _checked(Camera.typed(one_line(text, _MOST)))
    try:
        data = json.loads(text)
        model, params = data["model"], data["params"]
        if not (isinstance(model, str) and isinstance(params, list)):
            raise TypeError
        numbers = [_number(each) for each in (data["width"], data["height"], *params)]
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        raise CameraError(
            'a camera as JSON is of the form {"model": "PINHOLE", "width": 640, "height": 480, '
            '"params": [525.5, 525.5, 320, 240]}'
        ) from None
    return _checked(Camera.typed(" ".join([model, *map(repr, numbers)])))


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    return float(value)


def _checked(camera: Camera) -> Camera:
    if max(camera.width, camera.height) > 100_000:
        raise CameraError(f"a camera of {camera.width}x{camera.height} pixels is too large")
    return camera


def parse_prior(pose: str | None, sigmas: str | None) -> PosePrior | None:
    """An approximate pose and its standard deviations.

    Args:
        pose: ``qw qx qy qz tx ty tz``, or a 4x4 matrix as JSON; world to camera.
        sigmas: ``LENGTH DEGREES``.

    Raises:
        PoseError: one of them has another form.
    """
    pose, sigmas = (pose or "").strip(), (sigmas or "").strip()
    if not pose:
        if sigmas:
            raise PoseError("prior_sigma needs a prior")
        return None
    return PosePrior(parse_cam_from_world(pose), *_sigmas(sigmas))


def parse_cam_from_world(text: str) -> Any:
    """(4, 4) float64.

    Raises:
        PoseError: it is neither ``qw qx qy qz tx ty tz`` nor a 4x4 matrix as JSON.
    """
    text = text.strip()
    if len(text) > _MOST:
        raise PoseError(f"a pose's text has at most {_MOST} letters, not {len(text)}")
    if not text.startswith("["):
        return parse_pose(one_line(text, _MOST))
    try:
        matrix = np.asarray(json.loads(text), dtype=np.float64)
    except (ValueError, TypeError, OverflowError, RecursionError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4):
        raise PoseError("a pose as JSON is a 4x4 matrix, four lists of four numbers")
    return PosePrior(matrix).cam_from_world


def _sigmas(text: str) -> tuple[float, ...]:
    if not text:
        return ()
    try:
        sigmas = tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        sigmas = ()
    if len(sigmas) != 2 or not all(map(math.isfinite, sigmas)):
        raise PoseError("prior_sigma is of the form: LENGTH DEGREES")
    return sigmas


def photo_name(name: str | None) -> str:
    """What messages call a photo: the name that its sender gave it, without folders."""
    last = (name or "").replace("\\", "/").rsplit("/", 1)[-1]
    return one_line(last, 120) or "the photo"
