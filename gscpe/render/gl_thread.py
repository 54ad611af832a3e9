# SPDX-License-Identifier: Apache-2.0
"""An OpenGL rasterizer that any thread may call."""

from __future__ import annotations

import os

from gscpe.arrays import Float64Array
from gscpe.geometry.camera import Camera
from gscpe.render.context import check_process
from gscpe.render.gl_rasterizer import GlRasterizer
from gscpe.render.own_thread import OwnThread
from gscpe.render.view import RenderedView
from gscpe.splats.gaussians import GaussianScene


class GlThread:
    """Implements :class:`gscpe.render.rasterizer.Rasterizer`: a :class:`GlRasterizer` in a thread
    of its own (see ``own_thread.py``).

    Raises:
        RenderError: as :class:`GlRasterizer`.
    """

    def __init__(self, scene: GaussianScene) -> None:
        self._process = os.getpid()
        self._thread = OwnThread()
        try:
            self._rasterizer = self._thread.run(lambda: GlRasterizer(scene))
        except BaseException:
            self._thread.end(lambda: None)
            raise
        self.description = self._rasterizer.description

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        check_process(self._process)  # a fork has no such thread to wait for
        return self._thread.run(lambda: self._rasterizer.render(camera, cam_from_world))

    def close(self) -> None:
        if os.getpid() == self._process:
            self._thread.end(self._rasterizer.close)
