# SPDX-License-Identifier: Apache-2.0
"""Cameras whose intrinsics nobody wrote down."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.coarse import CoarseSettings, FocalEstimate, FocalSettings, estimate_focal_length, lift
from gscpe.geometry.camera import Camera
from gscpe.matching import Matcher
from gscpe.photos import to_uint8
from gscpe.render import Renders


def ordinary_camera(image: UInt8Array, settings: FocalSettings) -> Camera:
    """A guess for an (H, W, 3) image of which nothing is known."""
    height, width = image.shape[:2]
    focal = settings.ordinary * max(height, width)
    return Camera.pinhole(width, height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)


def estimate_camera(
    renderer: Renders,
    matcher: Matcher,
    prepared_photo: Any,
    guess: Camera,
    start_cam_from_world: Float64Array,
    start_camera: Camera,
    coarse: CoarseSettings,
    settings: FocalSettings,
) -> Camera | str:
    """The photo's camera; a string says why it cannot be told.

    Two rounds: with a render of the reference as its own camera saw it, then with one from
    where the photo was taken.

    Args:
        renderer: of the map's splat.
        matcher: which prepared the photo.
        prepared_photo: ``matcher.prepare(photo)``.
        guess: pinhole camera of the photo.
        start_cam_from_world: (4, 4), the reference pose.
        start_camera: pinhole camera of the reference.
        coarse: thresholds of matches.
        settings: see :class:`gscpe.coarse.FocalSettings`.
    """
    estimate: FocalEstimate | None = None
    view = renderer.render(start_camera, start_cam_from_world)
    near = replace(settings, widest=1 / settings.around, narrowest=settings.around, steps=3)
    for bounds in (settings, near):
        if estimate is not None:
            view = renderer.render(estimate.camera, estimate.cam_from_world)
        seen = view.opacity >= coarse.min_opacity
        matches = matcher.match(prepared_photo, matcher.prepare(to_uint8(view.rgb), seen))
        points_world, liftable = lift(view, matches.render_pixels, coarse.min_opacity)
        found = estimate_focal_length(
            points_world[liftable],
            matches.photo_pixels[liftable],
            guess if estimate is None else estimate.camera,
            coarse.pnp,
            bounds,
        )
        if isinstance(found, str):
            return found
        estimate = found
    assert estimate is not None
    return estimate.camera
