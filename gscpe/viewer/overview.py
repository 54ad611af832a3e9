# SPDX-License-Identifier: Apache-2.0
"""A picture of map and cameras as the page opens, without a browser: our own render, with frusta,
ellipsoids and the trajectory drawn into it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Sequence

import cv2
import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.projection import transform_points
from gscpe.photos import to_uint8
from gscpe.ranges import check_numbers, check_whole
from gscpe.render import RenderedView, Renderer
from gscpe.scene import Map
from gscpe.viewer.cameras import (
    COLOURS,
    EDGES,
    KINDS,
    TITLES,
    TRAJECTORY,
    ShownCamera,
    frustum_corners,
)
from gscpe.viewer.contents import Contents
from gscpe.viewer.ellipsoids import Ellipsoid
from gscpe.viewer.opening import opening
from gscpe.viewer.photos import Photos

Colour = tuple[int, int, int]

_STEP = 6.0  # pixels in which lines are drawn, each hidden or not
_HIDDEN = 0.25  # opacity of lines behind surfaces
_SHIFT = 4
"""Binary digits behind the point in OpenCV's drawing coordinates."""

_SMALLEST_PHOTO = 24.0  # pixels

_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class OverviewSettings:
    """A picture of the whole.

    Attributes:
        width, height: pixels.
        sigmas: standard deviations at which ellipsoids are drawn.
    """

    width: int = 1280
    height: int = 800
    sigmas: float = 5.0

    def __post_init__(self) -> None:
        check_whole(self, "width", "height", least=64)
        check_numbers(self, "sigmas", above=0)


def overview(
    map_: Map,
    contents: Contents,
    settings: OverviewSettings | None = None,
    photos: Photos | None = None,
    backend: str = "auto",
) -> UInt8Array:
    """The map as the page opens (:func:`gscpe.viewer.opening.opening`), with all that is shown,
    and a legend below it; (H, W, 3) uint8, as wide as the settings say and higher by the legend.

    Args:
        map_: that is rendered.
        contents: of it.
        settings: of the picture.
        photos: that are drawn into the frusta, as far as there are any.
        backend: of the renderer.

    Raises:
        RenderError, MissingDependencyError: as :class:`gscpe.Renderer`.
    """
    settings = settings or OverviewSettings()
    begin = opening(contents, map_.scene, backend)
    focal = settings.height / 2 / math.tan(begin.vertical_angle / 2)
    cx, cy = settings.width / 2, settings.height / 2
    camera = Camera(settings.width, settings.height, focal, focal, cx, cy)
    map_from_cam = se3.from_quaternion_translation(begin.quaternion, begin.position)
    with Renderer(map_.scene, backend) as renderer:
        view = renderer.render(camera, se3.inverse(map_from_cam))
    return draw_contents(view, contents, settings.sigmas, photos or Photos([]))


def draw_contents(
    view: RenderedView, contents: Contents, sigmas: float, photos: Photos
) -> UInt8Array:
    """The view with photos, cameras, ellipsoids and trajectory drawn into it, and a legend below,
    (H, W, 3) uint8; what lies behind a surface is faint."""
    bare = _on_white(view)
    _draw_photos(bare, view, contents, photos)
    picture, faint = bare.copy(), bare.copy()
    for camera in contents.cameras:
        _draw_camera(picture, faint, view, camera, contents.frustum_depth)
    for ellipsoid in contents.ellipsoids:
        for circle in _circles(ellipsoid, sigmas):
            _draw_line(picture, faint, view, circle, COLOURS["final"], 1)
    if contents.trajectory is not None:
        _draw_line(picture, faint, view, contents.trajectory.centres, TRAJECTORY, 2)
    mixed = np.asarray(cv2.addWeighted(faint, _HIDDEN, picture, 1.0 - _HIDDEN, 0.0), dtype=np.uint8)
    visible = np.any(picture != bare, axis=2)
    mixed[visible] = picture[visible]
    return np.concatenate([mixed, _legend_strip(_legend(contents, sigmas), mixed.shape[1])])


def _draw_photos(
    picture: UInt8Array, view: RenderedView, contents: Contents, photos: Photos
) -> None:
    """Into the frusta that are large enough, the farthest first."""
    drawn = []
    for shown in contents.cameras:
        if shown.kind in ("reference", "final"):
            corners = frustum_corners(shown.camera, shown.cam_from_map, contents.frustum_depth)
            x, y, z = transform_points(view.cam_from_world, corners[1:5]).T
            if np.all(z > 1e-6):
                camera = view.camera
                quad = np.stack(
                    [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1
                )
                drawn.append((float(z.mean()), shown, quad.astype(np.float32)))
    for depth, shown, quad in sorted(drawn, key=lambda each: -each[0]):
        wide = float(np.linalg.norm(quad[1] - quad[0]))
        small = photos.picture(shown, max(16, round(wide))) if wide >= _SMALLEST_PHOTO else None
        if small is None:
            continue
        height, width = small.shape[:2]
        flat = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=np.float32)
        # Both are in pixels whose first centre is (0.5, 0.5), OpenCV's is (0, 0).
        warp = cv2.getPerspectiveTransform(flat - 0.5, quad - np.float32(0.5))
        size = picture.shape[1], picture.shape[0]
        warped = cv2.warpPerspective(small, warp, size, flags=cv2.INTER_AREA)
        inside = cv2.warpPerspective(np.full((height, width), 255, np.uint8), warp, size) > 127
        before = (view.opacity < 0.5) | (depth < 1.02 * view.depth)
        picture[inside & before] = warped[inside & before]


def _on_white(view: RenderedView) -> UInt8Array:
    behind = (1.0 - view.opacity)[:, :, None]
    return to_uint8(np.asarray(view.rgb + behind, dtype=np.float32))


def _draw_camera(
    picture: UInt8Array, faint: UInt8Array, view: RenderedView, shown: ShownCamera, depth: float
) -> None:
    corners = frustum_corners(shown.camera, shown.cam_from_map, depth)
    for a, b in EDGES:
        _draw_line(picture, faint, view, corners[[a, b]], COLOURS[shown.kind], 1)


def _draw_line(
    picture: UInt8Array,
    faint: UInt8Array,
    view: RenderedView,
    points: Float64Array,
    colour: Colour,
    thickness: int,
) -> None:
    """A line through points of the map, (N, 3): where it is visible into ``picture``, all of it
    into ``faint``."""
    points = transform_points(view.cam_from_world, points)
    camera = view.camera
    for begin, end in pairwise(points):
        if min(begin[2], end[2]) <= 1e-6:
            continue
        ends = np.stack([begin, end])
        pixels = ends[:, :2] / ends[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        if np.any(np.abs(pixels) > 8 * max(camera.width, camera.height)):
            continue
        steps = max(1, math.ceil(float(np.linalg.norm(pixels[1] - pixels[0])) / _STEP))
        shares = np.linspace(0.0, 1.0, steps + 1)[:, None]
        way = (1 - shares) * pixels[0] + shares * pixels[1]
        # Depth is the inverse of what is linear along the line in the picture.
        depth = 1.0 / ((1 - shares) / begin[2] + shares / end[2])[:, 0]
        for i in range(steps):
            middle, z = (way[i] + way[i + 1]) / 2, (depth[i] + depth[i + 1]) / 2
            for canvas in (faint, picture) if _visible(view, middle, z) else (faint,):
                a, b = _opencv_point(way[i]), _opencv_point(way[i + 1])
                cv2.line(canvas, a, b, colour, thickness, cv2.LINE_AA, _SHIFT)


def _visible(view: RenderedView, pixel: Float64Array, depth: float) -> bool:
    """Whether no surface lies before this depth at a pixel."""
    column, row = int(pixel[0]), int(pixel[1])
    if not (0 <= row < view.camera.height and 0 <= column < view.camera.width):
        return False
    opaque = float(view.opacity[row, column]) > 0.5
    return not opaque or depth < 1.02 * float(view.depth[row, column])


def _circles(ellipsoid: Ellipsoid, sigmas: float) -> Sequence[Float64Array]:
    """Its three principal ellipses, (N, 3) points each."""
    angles = np.linspace(0.0, 2.0 * np.pi, 25)
    axes = se3.from_quaternion_translation(ellipsoid.quaternion, [0, 0, 0])[:3, :3]
    stretched = axes * (sigmas * ellipsoid.radii)
    return [
        ellipsoid.centre
        + np.outer(np.cos(angles), stretched[:, a])
        + np.outer(np.sin(angles), stretched[:, b])
        for a, b in ((0, 1), (1, 2), (0, 2))
    ]


def _legend(contents: Contents, sigmas: float) -> list[tuple[Colour | None, str]]:
    lines: list[tuple[Colour | None, str]] = []
    for kind in KINDS:
        count = len(contents.of_kind(kind))
        if count:
            lines.append((COLOURS[kind], f"{TITLES[kind]}{'s' * (count != 1)}: {count}"))
    if contents.ellipsoids:
        text = f"{sigmas:g} standard deviations of the final positions"
        lines.append((COLOURS["final"], text))
    if contents.trajectory is not None:
        lines.append((TRAJECTORY, f"trajectory: {len(contents.trajectory.times)} poses"))
    if contents.refused:
        lines.append((None, f"not localized: {len(contents.refused)}"))
    return lines


def _legend_strip(lines: Sequence[tuple[Colour | None, str]], width: int) -> UInt8Array:
    """Its entries in as many rows as they need, (H, W, 3) uint8."""
    row, scale, x, y = 26, 0.5, 12, 0
    places = []
    for colour, text in lines:
        needed = cv2.getTextSize(text, _FONT, scale, 1)[0][0] + 44
        if x > 12 and x + needed > width:
            x, y = 12, y + row
        places.append((x, y + row // 2 + 4, colour, text))
        x += needed
    strip = np.full((y + row + 8 if lines else 0, width, 3), 255, dtype=np.uint8)
    for x, y, colour, text in places:
        if colour is not None:
            cv2.rectangle(strip, (x, y - 6), (x + 12, y + 6), colour, -1)
        cv2.putText(strip, text, (x + 20, y + 5), _FONT, scale, (30, 30, 30), 1, cv2.LINE_AA)
    return strip


def _opencv_point(pixel: Float64Array) -> tuple[int, int]:
    """OpenCV draws the centre of the top-left pixel at (0, 0)."""
    column, row = np.rint((pixel - 0.5) * (1 << _SHIFT)).astype(int)
    return int(column), int(row)
