# SPDX-License-Identifier: Apache-2.0
"""What of a splat's surfaces views show: some of its Gaussians, and which of them are seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.geometry.camera import Camera
from gscpe.geometry.projection import transform_points
from gscpe.render import RenderedView, Renderer
from gscpe.splats import GaussianScene
from gscpe.viewpoints.axes import solid

_COUNT = 4000
"""A share of so many is known to 0.8% (standard deviation)."""
_HIDDEN = 1.1
"""A Gaussian is hidden where it is so many times as far as what is seen in its pixel."""
_SHOWN = 0.5
"""Opacity above which a pixel shows a surface."""
_SIDE = 96
"""Pixels of the longer side of the renders that tell what is hidden."""


@dataclass(frozen=True, eq=False)
class SurfaceSample:
    """Some of the Gaussians that surfaces consist of, each as likely as any other.

    Training adds Gaussians where photos showed detail, so that equal shares of them are more
    equal shares of what was photographed than equal areas are: most of the area is background.

    Attributes:
        points: (N, 3), centres in the frame of the scene, relative to its origin.
    """

    points: Float64Array

    @classmethod
    def of(cls, scene: GaussianScene, count: int = _COUNT) -> SurfaceSample:
        """At most ``count`` of a scene's solid Gaussians; the same every time."""
        rows = np.flatnonzero(solid(scene))
        if len(rows) > count:
            rows = np.random.default_rng(0).choice(rows, count, replace=False)
        return cls(scene.means[rows].astype(np.float64))

    def seen(self, view: RenderedView, camera: Camera, cam_from_scene: Float64Array) -> BoolArray:
        """Which of the points a render shows, (N,).

        Args:
            view: a render of the scene.
            camera: of the render; pinhole.
            cam_from_scene: (4, 4), of the render, relative to the scene's origin.
        """
        x, y, z = transform_points(cam_from_scene, self.points).T
        before = z > 0
        z_or_one = np.where(before, z, 1.0)
        u, v = camera.fx * x / z_or_one + camera.cx, camera.fy * y / z_or_one + camera.cy
        inside = before & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        rows = np.flatnonzero(inside)
        at = v[rows].astype(int), u[rows].astype(int)
        shown = (z[rows] < _HIDDEN * view.depth[at]) & (view.opacity[at] > _SHOWN)
        seen = np.zeros(len(z), dtype=bool)
        seen[rows[shown]] = True
        return seen


def times_seen(
    scene: GaussianScene,
    cam_from_scene: Float64Array,
    cameras: Sequence[Camera],
    renderer: Renderer,
) -> Float64Array:
    """How many of some views show each of a scene's sampled Gaussians, (N,).

    Args:
        scene: the splat.
        cam_from_scene: (V, 4, 4), relative to the scene's origin.
        cameras: V pinhole cameras.
        renderer: of the scene, in the same frame.
    """
    sample = SurfaceSample.of(scene)
    times = np.zeros(len(sample.points))
    for pose, camera in zip(cam_from_scene, cameras, strict=True):
        scale = min(1.0, _SIDE / max(camera.width, camera.height))
        small = camera.resized(
            max(1, round(scale * camera.width)), max(1, round(scale * camera.height))
        )
        times += sample.seen(renderer.render(small, pose), small, pose)
    return times
