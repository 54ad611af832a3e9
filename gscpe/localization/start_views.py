# SPDX-License-Identifier: Apache-2.0
"""What is seen from where attempts start: each matcher that is tried begins there again."""

from __future__ import annotations

from gscpe.arrays import Float64Array
from gscpe.geometry.camera import Camera
from gscpe.render import RenderedView, Renders

_MOST = 4
"""Views: of three places and a prior. One takes 24 bytes a pixel."""


class StartViews:
    """Implements :class:`gscpe.Renders` for one photo; views from its starts are made once.

    The first few are kept and not the latest: matchers see the starts in the same order, so that
    of more starts than there is room for, each of the latest would be gone when it is needed.

    Args:
        renderer: of the map's splat.
        camera: of the photo; views of other cameras are not kept.
    """

    def __init__(self, renderer: Renders, camera: Camera) -> None:
        self._renderer = renderer
        self._camera = camera
        self._kept: dict[bytes, RenderedView | None] = {}

    def keep(self, cam_from_world: Float64Array) -> None:
        """An attempt starts from this pose, (4, 4), and others may follow."""
        if len(self._kept) < _MOST:
            self._kept.setdefault(cam_from_world.tobytes())

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """As :meth:`gscpe.Renderer.render`."""
        pose = cam_from_world.tobytes()
        if camera != self._camera or pose not in self._kept:
            return self._renderer.render(camera, cam_from_world)
        view = self._kept[pose]
        if view is None:
            view = self._kept[pose] = self._renderer.render(camera, cam_from_world)
        return view
