# SPDX-License-Identifier: Apache-2.0
"""The pictures of one query: what the localizer saw, at the pose that it found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float64Array, UInt8Array
from gscpe.coarse.lift import lift
from gscpe.errors import InputError
from gscpe.geometry.camera import Camera
from gscpe.localization import Localizer
from gscpe.matching import Matcher, Matches
from gscpe.photos import luminance, read_image_of, to_uint8
from gscpe.refinement.visibility import surface_mask, visibility_mask
from gscpe.render import RenderedView
from gscpe.render.pictures import depth_picture
from gscpe.report.comparison import compare
from gscpe.report.settings import ReportSettings

GREEN, RED = (40, 200, 90), (235, 60, 50)
_NO_SURFACE, _CONTRADICTED = (200, 40, 120), (250, 170, 0)

_SHIFT = 4
"""Binary digits behind the point in OpenCV's drawing coordinates."""


@dataclass(frozen=True, eq=False)
class QueryPictures:
    """Pictures of a query, (H, W, 3) uint8 each, at the size that they are shown.

    Attributes:
        pictures: "photo", "render", "difference", "mask", "depth", "matches", of those that
            there are.
        trusted_pixels: share of the photo that the visibility mask leaves, or None.
        matches, inliers: of photo and render, drawn or not; None where nothing was matched.
        problem: why there are none at all, or None.
    """

    pictures: Mapping[str, UInt8Array]
    trusted_pixels: float | None = None
    matches: int | None = None
    inliers: int | None = None
    problem: str | None = None


def draw_query(
    detail: Mapping[str, Any],
    localizer: Localizer,
    matcher: Matcher | None,
    image_folder: Path,
    settings: ReportSettings,
) -> QueryPictures:
    """Renders and draws; the photo alone where no pose was found.

    Raises:
        RenderError, ModelError: rendering or matching failed.
    """
    try:
        camera = Camera.parse(str(detail["camera"]))
        image = read_image_of(image_folder / detail["name"], camera)
        compared = compare(detail, image, camera, localizer)
    except InputError as error:
        return QueryPictures({}, problem=str(error))
    photo, view = compared.photo, compared.view
    pictures = {"photo": photo.rgb}
    if view is None:
        return QueryPictures(_shrunk(pictures, settings.picture_width))
    pictures["render"] = to_uint8(view.rgb)
    trusted_pixels = None
    difference = compared.difference(settings.boost)
    if compared.trusted and difference is not None:
        mask_settings = localizer.settings.refinement.visibility
        unit = view.tolerance_unit(localizer.map.frame.scale)
        mask = visibility_mask(localizer, view, mask_settings, unit)
        trusted_pixels = float(mask.mean())
        pictures["difference"] = difference
        pictures["mask"] = _mask_picture(view, mask, surface_mask(view, mask_settings))
        pictures["depth"] = depth_picture(view.depth)
    pictures = _shrunk(pictures, settings.picture_width)
    if matcher is None:
        return QueryPictures(pictures, trusted_pixels)
    seen = view.opacity >= localizer.settings.coarse.min_opacity
    matches = matcher.match(
        matcher.prepare(photo.rgb, photo.valid), matcher.prepare(to_uint8(view.rgb), seen)
    )
    agree = _agree(matches, view, localizer)
    scale = pictures["photo"].shape[1] / photo.camera.width
    pictures["matches"] = _matches_picture(
        pictures["photo"], pictures["render"], matches, agree, scale, settings.matches
    )
    return QueryPictures(pictures, trusted_pixels, len(matches), int(np.count_nonzero(agree)))


def _shrunk(pictures: Mapping[str, UInt8Array], width: int) -> dict[str, UInt8Array]:
    return {name: _at_most(picture, width) for name, picture in pictures.items()}


def _at_most(picture: UInt8Array, width: int) -> UInt8Array:
    if picture.shape[1] <= width:
        return picture
    size = width, max(1, round(picture.shape[0] * width / picture.shape[1]))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _mask_picture(view: RenderedView, mask: BoolArray, surface: BoolArray) -> UInt8Array:
    """The render in grey; what is left out is coloured by the reason."""
    grey = np.repeat(luminance(view.rgb)[:, :, None], 3, axis=2)
    picture = to_uint8(grey).astype(np.float32)
    for left_out, colour in ((~surface, _NO_SURFACE), (surface & ~mask, _CONTRADICTED)):
        picture[left_out] = 0.35 * picture[left_out] + 0.65 * np.array(colour, dtype=np.float32)
    return np.asarray(picture, dtype=np.uint8)


def _agree(matches: Matches, view: RenderedView, localizer: Localizer) -> BoolArray:
    """Which matches, (M,), agree with the pose of the render: they lie on a surface, and at
    the same pixel of photo and render but for the inlier threshold of the coarse stage."""
    if not len(matches):
        return np.zeros(0, dtype=bool)
    settings = localizer.settings.coarse
    liftable = lift(view, matches.render_pixels, settings.min_opacity)[1]
    apart = np.linalg.norm(matches.photo_pixels - matches.render_pixels, axis=1)
    return np.asarray(liftable & (apart <= settings.pnp.inlier_pixels))


def _matches_picture(
    photo: UInt8Array,
    render: UInt8Array,
    matches: Matches,
    agree: BoolArray,
    scale: float,
    most: int,
) -> UInt8Array:
    """Photo and render side by side, a line a match: every n-th of them, the wrong ones above
    the right ones."""
    picture = np.ascontiguousarray(np.concatenate([photo, render], axis=1))
    drawn = np.arange(0, len(matches), max(1, -(-len(matches) // max(most, 1))))[:most]
    drawn = drawn[np.argsort(~agree[drawn], kind="stable")]
    to_render = np.array([photo.shape[1], 0.0])
    for index in drawn:
        begin = _opencv_point(scale * matches.photo_pixels[index])
        end = _opencv_point(scale * matches.render_pixels[index] + to_render)
        colour = GREEN if agree[index] else RED
        cv2.line(picture, begin, end, colour, 1, cv2.LINE_AA, _SHIFT)
        for point in (begin, end):
            cv2.circle(picture, point, 2 << _SHIFT, colour, -1, cv2.LINE_AA, _SHIFT)
    return picture


def _opencv_point(pixel: Float64Array) -> tuple[int, int]:
    """OpenCV draws the centre of the top-left pixel at (0, 0)."""
    column, row = np.rint((pixel - 0.5) * (1 << _SHIFT)).astype(int)
    return int(column), int(row)
