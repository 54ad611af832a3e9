# SPDX-License-Identifier: Apache-2.0
"""Renders a Gaussian splat from any pose, with the rasterizer that fits the machine."""

from __future__ import annotations

import threading
from dataclasses import replace

from gscpe.arrays import Float64Array
from gscpe.closing import Closing
from gscpe.errors import CameraError, ClosedError, RenderError, SplatError
from gscpe.geometry.camera import Camera
from gscpe.geometry.se3 import check_transform
from gscpe.render.context import import_moderngl
from gscpe.render.cpu_rasterizer import CpuRasterizer
from gscpe.render.rasterizer import Rasterizer, choose_backend
from gscpe.render.view import RenderedView
from gscpe.splats.gaussians import GaussianScene

MOST_PIXELS = 100_000_000
"""Of a picture: at 24 bytes each (:class:`gscpe.RenderedView`), 2.4 GB."""


class Renderer(Closing):
    """Holds one splat, on the graphics driver or in memory, and renders it from any pose.

    Close it, or use it as a context manager, to release the memory. Threads may share it: one
    picture is rendered at a time, by all cores or the GPU, and the other threads wait.

    Args:
        scene: the splat.
        backend: ``"auto"``, ``"gl"`` or ``"cpu"``; see :func:`gscpe.render.choose_backend`.
        progress: show a bar when the CPU rasterizer must be compiled first (once).

    Raises:
        RenderError: OpenGL is missing, too old, or failed.
        MissingDependencyError: ``backend="cpu"`` without Numba.
        SettingsError: there is no such backend.
        SplatError: the scene is something else.
    """

    def __init__(self, scene: GaussianScene, backend: str = "auto", progress: bool = False) -> None:
        if not isinstance(scene, GaussianScene):
            raise SplatError(
                f"a Renderer needs a GaussianScene, not a {type(scene).__name__}; gscpe.read_splat "
                "reads one, and the .scene of a map is one"
            )
        chosen = choose_backend(backend)
        self._rasterizer: Rasterizer | None = (
            _gl_rasterizer(scene) if chosen == "gl" else CpuRasterizer(scene, progress=progress)
        )
        self.description = self._rasterizer.description
        self._origin = scene.origin
        self._lock = threading.Lock()

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """The splat as this camera sees it.

        Args:
            camera: a pinhole camera; the principal point may be anywhere. At most 100 million
                pixels, with every backend; less where the graphics driver's limit is lower.
            cam_from_world: (4, 4) rigid transform.

        Raises:
            RenderError: the camera has distortion or too many pixels, or OpenGL failed.
            ClosedError: the renderer is closed.
            PoseError: the pose is not a rigid transform.
            CameraError: the camera is no Camera.
        """
        if not isinstance(camera, Camera):
            raise CameraError(f"rendering needs a gscpe.Camera, not a {type(camera).__name__}")
        if not camera.is_pinhole:
            raise RenderError("rendering needs a pinhole camera; undistort the photo first")
        if camera.width * camera.height > MOST_PIXELS:
            raise RenderError(
                f"a picture may have {MOST_PIXELS} pixels, not {camera.width}x{camera.height}; "
                "render a smaller one (Camera.resized)"
            )
        cam_from_world = check_transform(cam_from_world, "cam_from_world")
        cam_from_scene = cam_from_world.copy()
        cam_from_scene[:3, 3] += cam_from_world[:3, :3] @ self._origin
        try:
            with self._lock:
                if self._rasterizer is None:
                    raise ClosedError("this renderer is closed")
                view = self._rasterizer.render(camera, cam_from_scene)
        except MemoryError as error:
            raise RenderError(
                f"there is not enough memory to render {camera.width}x{camera.height} pixels"
            ) from error
        return replace(view, cam_from_world=cam_from_world.copy())

    def close(self) -> None:
        """Releases the memory, after the current picture is finished; the renderer cannot be used
        afterwards."""
        with self._lock:
            if self._rasterizer is not None:
                self._rasterizer.close()
                self._rasterizer = None


def _gl_rasterizer(scene: GaussianScene) -> Rasterizer:
    import_moderngl()
    from gscpe.render.gl_thread import GlThread

    return GlThread(scene)
