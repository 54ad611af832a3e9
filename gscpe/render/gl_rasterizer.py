# SPDX-License-Identifier: Apache-2.0
"""Renders a Gaussian splat with OpenGL: with compute shaders on GPUs that have them (4.3), else
with instanced, depth-sorted quads (3.3, any driver).
"""

from __future__ import annotations

import os
from typing import Any

import moderngl
import numpy as np

from gscpe.arrays import Float32Array, Float64Array
from gscpe.errors import RenderError
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centre
from gscpe.render.context import (
    DriverInfo,
    check_errors,
    check_process,
    create_context,
    describe,
)
from gscpe.render.gpu_sort import GL_NEEDED, GpuOrder, pays_on
from gscpe.render.gpu_tiles import GpuTiles
from gscpe.render.shader_source import shader_source
from gscpe.render.splatting import SlopeLimits
from gscpe.render.targets import ImageTargets, ProjectionTargets, data_texture
from gscpe.render.view import RenderedView
from gscpe.render.visibility_order import VisibilityOrder
from gscpe.splats.gaussians import GaussianScene

_SIZES_KEPT = 4


class GlRasterizer:
    """Implements :class:`gscpe.render.rasterizer.Rasterizer` with an OpenGL context of its own.
    Made, used and closed by one thread (:class:`gscpe.render.gl_thread.GlThread`).

    Args:
        scene: the splat.
        gpu_sort: whether the GPU culls and sorts; None: where the driver is a GPU's and has
            compute shaders (:func:`gscpe.render.gpu_sort.pays_on`).
        tiles: whether compute shaders composite, too (not without ``gpu_sort``); None: as
            ``gpu_sort``.

    Raises:
        RenderError: OpenGL is missing, too old, or failed.
    """

    def __init__(
        self, scene: GaussianScene, gpu_sort: bool | None = None, tiles: bool | None = None
    ) -> None:
        self._context: moderngl.Context | None = create_context()
        self._process = os.getpid()
        self._cpu_order: VisibilityOrder | None = None
        self._gpu_order: GpuOrder | None = None
        self._tiles: GpuTiles | None = None
        self._antialiased = scene.antialiased
        self._owned: list[Any] = []
        self._image_targets: dict[tuple[int, int], ImageTargets] = {}
        try:
            with self._context:
                self.driver: DriverInfo = describe(self._context)
                self._upload(self._context, scene)
                if gpu_sort is None:
                    gpu_sort = pays_on(self.driver)
                if gpu_sort:
                    self._gpu_order = self._make_gpu_order(self._context, scene)
                    if tiles is not False:
                        self._tiles = self._make_tiles(self._context, scene, self._gpu_order)
                else:
                    self._cpu_order = VisibilityOrder(scene)
                self.description = f"OpenGL, {self.driver.renderer}"
                check_errors(self._context, "uploading the splat")
        except moderngl.Error as error:
            self.close()
            raise RenderError(
                f"OpenGL failed to set up: {error} ({self.driver.renderer})"
            ) from error
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
                fragment_shader=shader_source(
                    "splat.frag", {"BLEND_FAINT": 1} if self.driver.is_software else None
                ),
            )
        )
        self._cover = self._own(context.vertex_array(self._project_program, []))
        self._quads = self._own(context.vertex_array(self._splat_program, []))

    def _make_gpu_order(self, context: moderngl.Context, scene: GaussianScene) -> GpuOrder:
        if self.driver.version_code < GL_NEEDED:
            raise RenderError(f"sorting on the GPU needs OpenGL 4.3; this is {self.driver.version}")
        order = GpuOrder(context, len(scene), scene.near, self._gaussians, self._projection)
        self._owned.append(order)
        return order

    def _make_tiles(
        self, context: moderngl.Context, scene: GaussianScene, order: GpuOrder
    ) -> GpuTiles:
        tiles = GpuTiles(context, len(scene), scene.sh.shape[1], self._projection, order.draw)
        self._owned.append(tiles)
        return tiles

    def _own(self, resource: Any) -> Any:
        self._owned.append(resource)
        return resource

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        if self._context is None:
            raise RenderError("this rasterizer is closed")
        check_process(self._process)
        with self._context as context:
            try:
                self._check_size(context, camera)
                count = self._sort(camera, cam_from_world)
                view = self._by_tiles(self._tiles, camera, cam_from_world) if self._tiles else None
                if view is None:
                    view = self._by_blending(context, count, camera, cam_from_world)
            except moderngl.Error as error:
                raise RenderError(
                    f"OpenGL failed to render: {error} ({self.driver.renderer})"
                ) from error
            check_errors(context, f"rendering {camera.width}x{camera.height} pixels")
        return view

    def _check_size(self, context: moderngl.Context, camera: Camera) -> None:
        limit = int(context.info["GL_MAX_TEXTURE_SIZE"])
        if max(camera.width, camera.height) > limit:
            raise RenderError(
                f"{camera.width}x{camera.height} is more than the driver's {limit} pixels"
            )

    def _by_tiles(
        self, tiles: GpuTiles, camera: Camera, cam_from_world: Float64Array
    ) -> RenderedView | None:
        """The view; None where so many large Gaussians overlap that tiles would take too much
        memory. Blending, slower, needs none for that."""
        values = self._projection_values(camera, cam_from_world)
        while True:
            self._gaussians.use(1)
            self._harmonics.use(2)
            tiles.project(camera, values)
            tiles.composite(camera)
            view = tiles.read(camera, cam_from_world)
            if view is not None or not tiles.grow():
                return view

    def _by_blending(
        self,
        context: moderngl.Context,
        count: int | None,
        camera: Camera,
        cam_from_world: Float64Array,
    ) -> RenderedView:
        targets = self._targets_for(context, camera.width, camera.height)
        self._project(count, camera, cam_from_world)
        self._draw(context, targets, count, camera)
        return self._read(targets, camera, cam_from_world)

    def _sort(self, camera: Camera, cam_from_world: Float64Array) -> int | None:
        """Puts the draw order in place; returns its length where it is known here."""
        if self._gpu_order is not None:
            self._gpu_order.update(camera, cam_from_world)
            return None
        assert self._cpu_order is not None
        order = self._cpu_order.back_to_front(camera, cam_from_world)
        self._projection.write_order(order)
        return len(order)

    def _targets_for(self, context: moderngl.Context, width: int, height: int) -> ImageTargets:
        """Targets of this size, kept for the last few sizes (a pyramid alternates them)."""
        targets = self._image_targets.pop((width, height), None)
        if targets is None:
            targets = ImageTargets(context, width, height)
            if len(self._image_targets) == _SIZES_KEPT:
                # The oldest, never the bound one: moderngl binds that again when it
                # creates the next framebuffer, which fails if it has been deleted.
                self._image_targets.pop(next(iter(self._image_targets))).release()
        self._image_targets[width, height] = targets
        return targets

    def _project(self, count: int | None, camera: Camera, cam_from_world: Float64Array) -> None:
        program = self._project_program
        self._projection.order.use(0)
        self._gaussians.use(1)
        self._harmonics.use(2)
        self._projection.visible_count.use(3)
        values = self._projection_values(camera, cam_from_world)
        for name, value in (values | {"order": 0, "visible_count": 3}).items():
            if name in program:  # at degree 0 the compiler drops the view direction
                program[name].value = value
        self._projection.use(count)
        self._cover.render(moderngl.TRIANGLES, vertices=3)

    def _projection_values(self, camera: Camera, cam_from_world: Float64Array) -> dict[str, Any]:
        """The uniforms of ``projection.glsl``; its textures are bound to 1 and 2."""
        limits = SlopeLimits.of(camera)
        return {
            "gaussians": 1,
            "harmonics": 2,
            "camera_centre": tuple(camera_centre(cam_from_world)),
            "focal": (camera.fx, camera.fy),
            "principal": (camera.cx, camera.cy),
            "slope_limit": (limits.low_x, limits.low_y, limits.high_x, limits.high_y),
            "antialiased": self._antialiased,
            "cam_from_world": [tuple(row) for row in cam_from_world[:3]],
        }

    def _draw(
        self, context: moderngl.Context, targets: ImageTargets, count: int | None, camera: Camera
    ) -> None:
        program = self._splat_program
        for unit, name in enumerate(("ellipses", "extents", "colours")):
            self._projection.textures[unit].use(unit)
            program[name].value = unit
        program["image_size"].value = (camera.width, camera.height)
        targets.clear_and_use()
        self._draw_quads(context, count)

    def _read(
        self, targets: ImageTargets, camera: Camera, cam_from_world: Float64Array
    ) -> RenderedView:
        colour, moments = targets.read()
        return _to_view(colour, moments, camera, cam_from_world)

    def _draw_quads(self, context: moderngl.Context, count: int | None) -> None:
        context.enable_only(moderngl.BLEND)
        context.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        if count is None:
            assert self._gpu_order is not None
            self._quads.render_indirect(self._gpu_order.draw, moderngl.TRIANGLE_STRIP, count=1)
        elif count:
            self._quads.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)
        context.enable_only(moderngl.NOTHING)

    def close(self) -> None:
        if self._context is None:
            return
        if os.getpid() != self._process:  # a fork; what is on the driver is the parent's
            self._context = None
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
