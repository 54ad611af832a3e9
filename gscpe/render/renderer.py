"""Renders a Gaussian splat from any pose, with the rasterizer that fits the machine."""

from __future__ import annotations

from gscpe.arrays import Float64Array
from gscpe.closing import Closing
from gscpe.errors import RenderError
from gscpe.geometry.camera import Camera
from gscpe.geometry.se3 import check_transform
from gscpe.render.context import import_moderngl
from gscpe.render.cpu_rasterizer import CpuRasterizer
from gscpe.render.rasterizer import Rasterizer, choose_backend
from gscpe.render.view import RenderedView
from gscpe.scene.gaussians import GaussianScene


class Renderer(Closing):
    """Holds one splat, on the graphics driver or in memory, and renders it from any pose.

    Use it from one thread at a time, and close it (or use it as a context manager) to give
    the memory back.

    Args:
        scene: the splat.
        backend: ``"auto"``, ``"gl"`` or ``"cpu"``; see :func:`gscpe.render.choose_backend`.
        progress: show a bar when the CPU rasterizer must be compiled first (once).

    Raises:
        RenderError: OpenGL is missing, too old, or failed.
        MissingDependencyError: ``backend="cpu"`` without Numba.
        SettingsError: there is no such backend.
    """

    def __init__(self, scene: GaussianScene, backend: str = "auto", progress: bool = False) -> None:
        chosen = choose_backend(backend)
        self._rasterizer: Rasterizer | None = (
            _gl_rasterizer(scene) if chosen == "gl" else CpuRasterizer(scene, progress=progress)
        )
        self.description = self._rasterizer.description

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """The splat as this camera sees it.

        Args:
            camera: a pinhole camera; the principal point may be anywhere.
            cam_from_world: (4, 4) rigid transform.

        Raises:
            RenderError: the camera has distortion, the renderer is closed, or OpenGL failed.
            PoseError: the pose is not a rigid transform.
        """
        if self._rasterizer is None:
            raise RenderError("this renderer is closed")
        if not camera.is_pinhole:
            raise RenderError("rendering needs a pinhole camera; undistort the photo first")
        cam_from_world = check_transform(cam_from_world, "cam_from_world")
        try:
            return self._rasterizer.render(camera, cam_from_world)
        except MemoryError as error:
            raise RenderError(
                f"there is not enough memory to render {camera.width}x{camera.height} pixels"
            ) from error

    def close(self) -> None:
        """Gives the memory back; the renderer cannot be used after."""
        if self._rasterizer is not None:
            self._rasterizer.close()
            self._rasterizer = None


def _gl_rasterizer(scene: GaussianScene) -> Rasterizer:
    import_moderngl()
    from gscpe.render.gl_rasterizer import GlRasterizer

    return GlRasterizer(scene)
