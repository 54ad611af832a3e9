# SPDX-License-Identifier: Apache-2.0
"""Where one looks from at first: inside of a room, and at the whole of what cameras went around.

Candidates stand a little behind reference photos, or see all of them from outside. Each is judged
by a small render: how much of what the photos show is seen from there, hidden neither by walls nor
by the cameras that are drawn.
"""

from __future__ import annotations

import itertools
import math
from typing import Iterator, Sequence

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centre
from gscpe.geometry.projection import transform_points
from gscpe.geometry.spread import farthest_first
from gscpe.render import RenderedView, Renderer
from gscpe.splats import GaussianScene
from gscpe.viewer.cameras import ShownCamera, Viewpoint, frustum_corners
from gscpe.viewer.contents import Contents
from gscpe.viewer.framing import (
    framing_pose,
    looked_at,
    mean_look,
    shown_points,
    upright_rotation,
)
from gscpe.viewer.splat import most_visible

_ANGLE = math.radians(50.0)
"""Of the window's height."""

_MOST_GAUSSIANS = 250_000  # more are thinned
_WINDOW = (160, 100)  # pixels in which candidates are judged
_PHOTOS = 20  # whose surfaces should be seen, each shrunk to so many pixels:
_PHOTO_SIDE = 40
_STANDS = 8  # photos behind which one may stand
_BACK = (0.25, 0.6)  # how far behind, in typical depths
_RAISED = 0.4  # of that
_PITCH = math.radians(25.0)  # up or down at most
_AZIMUTHS = 6
_ELEVATIONS = (math.radians(12.0), math.radians(30.0))
_DEPTHS_DIFFER = 0.07  # share of the depth by which a surface may seem to lie elsewhere,
_COLOURS_DIFFER = 0.2  # and by which a channel may differ: beyond that, something lies before it
_FAR = 4.0  # typical depths from which on it may seem to lie anywhere: the sky
_NEAREST = 1e-6  # map units before the eye
_NEARBY = 7  # pixels around such a surface that are known as well
_OF_UNKNOWN = 0.7
"""What a picture loses that shows nothing that photos have seen: floaters, backs of walls."""

_OF_FILLED = 0.3
"""What a picture wins that is full of what photos have seen: from far away, all is small."""
_OF_CAMERAS = 0.05
"""What it is worth to have all cameras in the picture, of having all surfaces in it."""


def opening(contents: Contents, scene: GaussianScene, backend: str = "auto") -> Viewpoint:
    """Where somebody who opens the map looks from, upright.

    Args:
        contents: cameras and a trajectory, all of which may be missing; up and typical depth.
        scene: the map's.
        backend: of the renderer.

    Raises:
        RenderError, MissingDependencyError: as :class:`gscpe.Renderer`.
    """
    window = _window()
    eyes = np.array([camera_centre(each.cam_from_map) for each in _photos(contents)])
    if not len(eyes):
        middle = np.quantile(scene.means, (0.05, 0.95), axis=0)
        corners = np.array(list(itertools.product(*middle.T)))
        level, up = contents.axes[1:]
        return _viewpoint(framing_pose(corners, level, _ELEVATIONS[-1], up, window))
    if len(scene) > _MOST_GAUSSIANS:
        scene = scene.taken(most_visible(scene, _MOST_GAUSSIANS, eyes))
    solid = scene.means[scene.opacities > 0.5]
    with Renderer(scene, backend) as renderer:
        surfaces = _Surfaces(contents, renderer)

        def score(pose: Float64Array) -> float:
            apart = np.linalg.norm(solid - camera_centre(pose).astype(np.float32), axis=1)
            # Renders leave out what is so near, as the wall that one stands in.
            inside_of_something = bool(np.any(apart < scene.near))
            return surfaces.score(renderer.render(window, pose)) - inside_of_something

        return _viewpoint(max(_candidates(contents, window), key=score))


def from_afar(contents: Contents) -> Viewpoint:
    """From behind and above, where all cameras and what they look at are in the window; walls may
    be in the way."""
    points = np.concatenate([shown_points(contents), looked_at(contents)])
    ahead = mean_look(contents)
    return _viewpoint(framing_pose(points, ahead, _ELEVATIONS[-1], contents.up, _window()))


def _window() -> Camera:
    width, height = _WINDOW
    focal = height / 2 / math.tan(_ANGLE / 2)
    return Camera(width, height, focal, focal, width / 2, height / 2)


def _viewpoint(cam_from_map: Float64Array) -> Viewpoint:
    quaternion, position = se3.to_quaternion_translation(se3.inverse(cam_from_map))
    return Viewpoint(position, quaternion, _ANGLE)


def _candidates(contents: Contents, window: Camera) -> Iterator[Float64Array]:
    """Poses, ``cam_from_map``: from outside, all around; and behind photos."""
    up, ahead = contents.up, mean_look(contents)
    points = np.concatenate([shown_points(contents), looked_at(contents)])
    for elevation, turn in itertools.product(_ELEVATIONS, range(_AZIMUTHS)):
        level = se3.exp([0, 0, 0, *(2 * math.pi * turn / _AZIMUTHS * up)])[:3, :3] @ ahead
        yield framing_pose(points, level, elevation, up, window)
    for shown, back in itertools.product(_spread_out(contents, _STANDS), _BACK):
        yield _behind(shown, back * contents.depth, up)


def _behind(shown: ShownCamera, distance: float, up: Float64Array) -> Float64Array:
    """Upright, a little behind and above a camera, looking as it does."""
    look = shown.cam_from_map[2, :3]
    pitch = math.asin(float(np.clip(look @ up, -1.0, 1.0)))
    # A camera that looks straight down has its top ahead.
    level = (
        look - (look @ up) * up if abs(pitch) < math.radians(80.0) else -shown.cam_from_map[1, :3]
    )
    level = level - (level @ up) * up
    level /= np.linalg.norm(level)
    pitch = float(np.clip(pitch, -_PITCH, _PITCH))
    forward = math.cos(pitch) * level + math.sin(pitch) * up
    rotation = upright_rotation(forward, up)
    eye = camera_centre(shown.cam_from_map) - distance * forward + _RAISED * distance * up
    return se3.from_rotation_translation(rotation, -rotation @ eye)


class _Surfaces:
    """What photos show: points with colours."""

    def __init__(self, contents: Contents, renderer: Renderer) -> None:
        self._contents = contents
        points, colours = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for shown in _spread_out(contents, _PHOTOS):
            pinhole = shown.camera.without_distortion()
            shrink = _PHOTO_SIDE / max(pinhole.width, pinhole.height)
            size = (max(1, round(shrink * side)) for side in (pinhole.width, pinhole.height))
            view = renderer.render(pinhole.resized(*size), shown.cam_from_map)
            solid = (view.opacity > 0.5) & (view.depth > 0)
            points.append(_back_projected(view, solid))
            colours.append(view.rgb[solid].astype(np.float64))
        self.points, self._colours = np.concatenate(points), np.concatenate(colours)

    def score(self, view: RenderedView) -> float:
        """The share of the points that is seen; and, counting less, of the cameras and of the
        picture that shows something else."""
        hidden, cameras = self._cameras_in(view)
        x, y, z = _pixels(view, self.points)
        inside = _inside(view, x, y, z)
        at = np.floor(y[inside]).astype(int), np.floor(x[inside]).astype(int)
        differ = np.abs(view.rgb[at] - self._colours[inside]).max(axis=1)
        depth, z = view.depth[at], z[inside]
        far = np.minimum(depth, z) > _FAR * self._contents.depth
        seen = (np.abs(depth - z) < _DEPTHS_DIFFER * z) | far
        seen &= differ < _COLOURS_DIFFER
        known = np.zeros(view.opacity.shape, np.uint8)
        known[at[0][seen], at[1][seen]] = 1
        known = np.asarray(cv2.dilate(known, np.ones((_NEARBY, _NEARBY), np.uint8)), np.uint8)
        opaque = view.opacity > 0.5
        unknown, filled = np.mean(opaque & (known == 0)), np.mean(opaque & (known > 0))
        share = np.count_nonzero(seen & ~hidden[at]) / max(1, len(self.points))
        return float(share + _OF_CAMERAS * cameras + _OF_FILLED * filled - _OF_UNKNOWN * unknown)

    def _cameras_in(self, view: RenderedView) -> tuple[BoolArray, float]:
        """Pixels that are hidden by the photos in frusta, (H, W), and the share of the cameras
        that are in the picture."""
        hidden, count = np.zeros(view.opacity.shape, np.uint8), 0
        shown = self._contents.cameras
        for each in shown:
            corners = frustum_corners(each.camera, each.cam_from_map, self._contents.frustum_depth)
            x, y, z = _pixels(view, corners)
            count += bool(np.all(_inside(view, x, y, z)))
            if np.all(z[1:5] > _NEAREST):
                outline = np.clip(np.stack([x, y], axis=1)[1:5], -1e4, 1e4)
                cv2.fillConvexPoly(hidden, np.rint(outline).astype(np.int32), (1,))
        return hidden > 0, count / max(1, len(shown))


def _pixels(view: RenderedView, points: Float64Array) -> tuple[Float64Array, ...]:
    """x, y and z-depth of points, (N,) each; behind the eye, x and y mean nothing."""
    x, y, z = transform_points(view.cam_from_world, points).T
    ahead, camera = np.maximum(z, _NEAREST), view.camera
    return camera.fx * x / ahead + camera.cx, camera.fy * y / ahead + camera.cy, z


def _inside(view: RenderedView, x: Float64Array, y: Float64Array, z: Float64Array) -> BoolArray:
    inside = (z > _NEAREST) & (x >= 0) & (y >= 0)
    return np.asarray(inside & (x < view.camera.width) & (y < view.camera.height))


def _back_projected(view: RenderedView, where: BoolArray) -> Float64Array:
    """(N, 3) points of the map."""
    row, column = np.nonzero(where)
    camera, z = view.camera, view.depth[where].astype(np.float64)
    x = (column + 0.5 - camera.cx) / camera.fx * z
    y = (row + 0.5 - camera.cy) / camera.fy * z
    return transform_points(se3.inverse(view.cam_from_world), np.stack([x, y, z], axis=1))


def _spread_out(contents: Contents, count: int) -> list[ShownCamera]:
    """So many of the photos, far from each other in place and direction."""
    cameras = _photos(contents)
    if not cameras:
        return []
    where = [camera_centre(c.cam_from_map) / contents.depth for c in cameras]
    looks = [c.cam_from_map[2, :3] for c in cameras]
    chosen = farthest_first(np.hstack([where, looks]), count)
    return [cameras[i] for i in chosen]


def _photos(contents: Contents) -> Sequence[ShownCamera]:
    """References, where there are some; else photos, or what the trajectory passes."""
    cameras = contents.of_kind("reference") or contents.of_kind("final") or contents.cameras
    walk = contents.trajectory
    if cameras or walk is None:
        return cameras
    return [ShownCamera("final", "", pose, walk.camera) for pose in walk.cam_from_map]
