"""Renders a Gaussian splat with instanced, depth-sorted quads (OpenGL 3.3, any driver)."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array, Float64Array
from gscpe.errors import RenderError
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centre
from gscpe.render.context import DriverInfo, create_context, describe
from gscpe.render.shader_source import shader_source
from gscpe.render.splatting import SlopeLimits
from gscpe.render.targets import ImageTargets, ProjectionTargets, data_texture
from gscpe.render.view import RenderedView
from gscpe.render.visibility_order import VisibilityOrder
from gscpe.scene.gaussians import GaussianScene

_SIZES_KEPT = 4


class GlRasterizer:
    """Implements :class:`gscpe.render.rasterizer.Rasterizer` with an OpenGL context of its own.

    Raises:
        RenderError: OpenGL is missing, too old, or failed.
    """

    def __init__(self, scene: GaussianScene) -> None:
        self._context: moderngl.Context | None = create_context()
        self._order = VisibilityOrder(scene)
        self._antialiased = scene.antialiased
        self._owned: list[Any] = []
        self._image_targets: dict[tuple[int, int], ImageTargets] = {}
        try:
            with self._context:
                self.driver: DriverInfo = describe(self._context)
                self._upload(self._context, scene)
                self.description = f"OpenGL, {self.driver.renderer}"
                self._check_errors("uploading the splat")
        except moderngl.Error as error:
            self.close()
            raise RenderError(f"OpenGL failed to set up: {error}") from error
        except BaseException:
            self.close()
            raise

    def _upload(self, context: moderngl.Context, scene: GaussianScene) -> None:
        packed = np.zeros((len(scene), 3, 4), dtype=np.float32)
        packed[:, 0, :3] = scene.means
        packed[:, 0, 3] = scene.opacities
        packed[:, 1] = scene.quaternions
        packed[:, 2, :3] = scene.scales
        self._gaussians = self._own(data_texture(context, packed.reshape(-1, 4)))
        self._harmonics = self._own(data_texture(context, scene.sh.reshape(-1, 3)))
        self._projection = ProjectionTargets(context, len(scene))
        self._owned.append(self._projection)
        self._project_program = self._own(
            context.program(
                vertex_shader=shader_source("cover.vert"),
                fragment_shader=shader_source("project.frag", {"SH_COUNT": scene.sh.shape[1]}),
            )
        )
        self._splat_program = self._own(
            context.program(
                vertex_shader=shader_source("splat.vert"),
                fragment_shader=shader_source("splat.frag"),
            )
        )
        self._cover = self._own(context.vertex_array(self._project_program, []))
        self._quads = self._own(context.vertex_array(self._splat_program, []))

    def _own(self, resource: Any) -> Any:
        self._owned.append(resource)
        return resource

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        if self._context is None:
            raise RenderError("this rasterizer is closed")
        order = self._order.back_to_front(camera, cam_from_world)
        with self._context as context:
            targets = self._targets_for(context, camera.width, camera.height)
            self._project(order, camera, cam_from_world)
            colour, moments = self._splat(context, targets, len(order), camera)
            self._check_errors("rendering")
        return _to_view(colour, moments, camera, cam_from_world)

    def _targets_for(self, context: moderngl.Context, width: int, height: int) -> ImageTargets:
        """Targets of this size, kept for the last few sizes (a pyramid alternates them)."""
        targets = self._image_targets.pop((width, height), None)
        if targets is None:
            limit = int(context.info["GL_MAX_TEXTURE_SIZE"])
            if max(width, height) > limit:
                raise RenderError(f"{width}x{height} is more than the driver's {limit} pixels")
            targets = ImageTargets(context, width, height)
            if len(self._image_targets) == _SIZES_KEPT:
                # The oldest, never the bound one: moderngl binds that again when it
                # creates the next framebuffer, which fails if it has been deleted.
                self._image_targets.pop(next(iter(self._image_targets))).release()
        self._image_targets[width, height] = targets
        return targets

    def _project(
        self, order: NDArray[np.uint32], camera: Camera, cam_from_world: Float64Array
    ) -> None:
        program, limits = self._project_program, SlopeLimits.of(camera)
        self._projection.write_order(order)
        self._projection.order.use(0)
        self._gaussians.use(1)
        self._harmonics.use(2)
        values: dict[str, Any] = {
            "order": 0,
            "gaussians": 1,
            "harmonics": 2,
            "visible_count": len(order),
            "camera_centre": tuple(camera_centre(cam_from_world)),
            "focal": (camera.fx, camera.fy),
            "principal": (camera.cx, camera.cy),
            "slope_limit": (limits.low_x, limits.low_y, limits.high_x, limits.high_y),
            "antialiased": self._antialiased,
            "cam_from_world": [tuple(row) for row in cam_from_world[:3]],
        }
        for name, value in values.items():
            if name in program:  # at degree 0 the compiler drops the view direction
                program[name].value = value
        self._projection.use(len(order))
        self._cover.render(moderngl.TRIANGLES, vertices=3)

    def _splat(
        self, context: moderngl.Context, targets: ImageTargets, count: int, camera: Camera
    ) -> tuple[Float32Array, Float32Array]:
        program = self._splat_program
        for unit, name in enumerate(("ellipses", "extents", "colours")):
            self._projection.textures[unit].use(unit)
            program[name].value = unit
        program["image_size"].value = (camera.width, camera.height)
        targets.clear_and_use()
        if count:
            context.enable_only(moderngl.BLEND)
            context.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
            self._quads.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)
            context.enable_only(moderngl.NOTHING)
        return targets.read()

    def _check_errors(self, doing: str) -> None:
        assert self._context is not None
        error = self._context.error
        if error != "GL_NO_ERROR":
            raise RenderError(f"OpenGL reported {error} when {doing} ({self.driver.renderer})")

    def close(self) -> None:
        if self._context is None:
            return
        with self._context:
            for targets in self._image_targets.values():
                targets.release()
            self._image_targets.clear()
            for resource in reversed(self._owned):
                resource.release()
            self._owned.clear()
        self._context.release()
        self._context = None


def _to_view(
    colour: Float32Array, moments: Float32Array, camera: Camera, cam_from_world: Float64Array
) -> RenderedView:
    opacity = np.ascontiguousarray(colour[:, :, 3])
    seen = opacity > 0
    weight = np.where(seen, opacity, 1.0).astype(np.float32)
    depth = np.where(seen, moments[:, :, 0] / weight, 0.0).astype(np.float32)
    squared = np.where(seen, moments[:, :, 1] / weight, 0.0)
    return RenderedView(
        rgb=np.ascontiguousarray(colour[:, :, :3]),
        opacity=opacity,
        depth=depth,
        depth_variance=np.maximum(squared - depth**2, 0.0).astype(np.float32),
        camera=camera,
        cam_from_world=cam_from_world.copy(),
    )
