# SPDX-License-Identifier: Apache-2.0
"""Photos that were taken with the camera held upside down or on its side.

Learned features match upright photos alone. So a photo that is not recognized is turned by
quarters, localized as if it had been taken so, and what was found is turned back.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.coarse import CameraEstimate, CoarseResult
from gscpe.geometry import se3
from gscpe.localization.attempt import Attempt
from gscpe.localization.prepared import PreparedPhoto
from gscpe.photos import Photo
from gscpe.photos.orientation import (
    inverse_orientation,
    numbers_turned,
    turned_camera,
    turned_from_cam,
    turned_image,
)
from gscpe.refinement import RefinementResult

_Stage = TypeVar("_Stage", CoarseResult, RefinementResult)


def turned_photo(photo: Photo, orientation: int) -> Photo:
    """A photo turned by EXIF's orientation, with its camera."""
    valid = photo.valid
    return Photo(
        turned_image(photo.rgb, orientation),
        turned_camera(photo.camera, orientation),
        None if valid is None else turned_image(valid.astype(np.uint8), orientation) > 0,
    )


def turned_back(attempt: Attempt, turned: PreparedPhoto) -> Attempt:
    """What came of a turned photo, as of the photo that was taken."""
    cam_from_turned = se3.inverse(turned_from_cam(turned.orientation))
    start = attempt.start
    coarse = _of_the_camera(attempt.coarse, cam_from_turned)
    if coarse is not None:
        pixels = pixels_turned_back(coarse.inlier_pixels, turned)
        rival_pixels = pixels_turned_back(coarse.rival_pixels, turned)
        estimate = coarse.intrinsics and estimate_turned_back(coarse.intrinsics, turned.orientation)
        coarse = replace(
            coarse, inlier_pixels=pixels, rival_pixels=rival_pixels, intrinsics=estimate
        )
    aligned = _of_the_camera(attempt.aligned, cam_from_turned)
    if aligned is not None and aligned.cam_from_world is not None:
        adjoint = se3.adjoint(cam_from_turned)
        unshared, by_camera = aligned.unshared, aligned.by_camera
        numbers = numbers_turned(turned.orientation)
        aligned = replace(
            aligned,
            unshared=None if unshared is None else adjoint @ unshared @ adjoint.T,
            by_camera=None if by_camera is None else adjoint @ by_camera @ numbers,
        )
    return replace(
        attempt,
        start=replace(start, cam_from_world=cam_from_turned @ start.cam_from_world),
        coarse=coarse,
        aligned=aligned,
        orientation=turned.orientation,
    )


def estimate_turned_back(estimate: CameraEstimate, orientation: int) -> CameraEstimate:
    """A camera that was estimated from a turned photo, as that of the photo that was taken."""
    back = inverse_orientation(orientation)
    numbers = numbers_turned(back)
    return replace(
        estimate,
        camera=turned_camera(estimate.camera, back),
        cam_from_world=turned_from_cam(back) @ estimate.cam_from_world,
        change=numbers @ estimate.change,
        covariance=numbers @ estimate.covariance @ numbers.T,
    )


def _of_the_camera(result: _Stage | None, cam_from_turned: Float64Array) -> _Stage | None:
    if result is None or result.cam_from_world is None:
        return result
    adjoint, covariance = se3.adjoint(cam_from_turned), result.covariance
    return replace(
        result,
        cam_from_world=cam_from_turned @ result.cam_from_world,
        covariance=None if covariance is None else adjoint @ covariance @ adjoint.T,
    )


def pixels_turned_back(pixels: Float64Array, turned: PreparedPhoto) -> Float64Array:
    """Pixels of the turned photo, (N, 2), in the photo that was taken."""
    camera = turned.photo.camera
    in_turned = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    cam_from_turned = turned_from_cam(turned.orientation)[:2, :2].T
    stored = turned_camera(camera, inverse_orientation(turned.orientation))
    in_cam = in_turned @ cam_from_turned.T
    return np.asarray(in_cam * [stored.fx, stored.fy] + [stored.cx, stored.cy])
