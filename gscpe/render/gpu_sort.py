# SPDX-License-Identifier: Apache-2.0
"""Culls and sorts on the GPU, so that a frame uploads nothing and waits for nothing (GL 4.3)."""

from __future__ import annotations

import moderngl
import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.camera import Camera
from gscpe.render.context import COMPUTE_GL, DriverInfo
from gscpe.render.gpu_radix import BLOCK, DEFINES, SCAN_THREADS, Programs, RadixSort
from gscpe.render.splatting import SlopeLimits
from gscpe.render.targets import ProjectionTargets

GL_NEEDED = COMPUTE_GL


def pays_on(driver: DriverInfo) -> bool:
    """Whether to use compute shaders on this driver's device: a GPU that has them. A driver that
    runs on the CPU would do there, slower, what NumPy and blending do."""
    return not driver.is_software and driver.version_code >= GL_NEEDED


class GpuOrder:
    """Writes the draw order of a splat into its :class:`ProjectionTargets`.

    The order is that of :func:`gscpe.render.visibility_order.depth_order`, reversed, to the bit:
    farthest first; of equal depths the later index first. A radix sort of the depths' bits, of
    those Gaussians that the image may show.

    Args:
        context: with OpenGL 4.3 or later; it must be current in all calls.
        count: the number of Gaussians.
        near: distance below which their centres are too near to be drawn.
        gaussians: the texture that ``projection.glsl`` reads.
        targets: whose ``order`` and ``visible_count`` are written.
    """

    def __init__(
        self,
        context: moderngl.Context,
        count: int,
        near: float,
        gaussians: moderngl.Texture,
        targets: ProjectionTargets,
    ) -> None:
        self._count, self._near = count, near
        self._gaussians, self._targets = gaussians, targets
        self._blocks = -(-count // BLOCK)
        self._programs = Programs(context)
        self._cull = self._programs.compile("cull.comp", DEFINES)
        self._scan = self._programs.compile(
            "scan.comp", DEFINES | {"THREADS": SCAN_THREADS, "AFTER_CULLING": 1}
        )
        self._compact = self._programs.compile("compact.comp", DEFINES)
        self._sort = RadixSort(self._programs, count)
        self._keys = context.buffer(reserve=4 * count)
        self._counts = context.buffer(reserve=4 * self._blocks)
        # The arguments of an indirect draw of quads: vertices, instances, three offsets.
        self.draw = context.buffer(np.array([4, 0, 0, 0, 0], dtype=np.uint32).tobytes())

    def update(self, camera: Camera, cam_from_world: Float64Array) -> None:
        """Queues the work for one view; ``draw`` then holds the number of instances."""
        self._gaussians.use(0)
        self._programs.run(
            self._cull,
            (self._blocks,),
            {0: self._keys, 1: self._counts},
            gaussian_count=self._count,
            gaussians=0,
            cam_from_world=[tuple(row) for row in cam_from_world[:3]],
            focal=(camera.fx, camera.fy),
            principal=(camera.cx, camera.cy),
            image_size=(camera.width, camera.height),
            stretch=max(camera.fx, camera.fy) * SlopeLimits.of(camera).stretch(),
            near=self._near,
        )
        self._targets.visible_count.bind_to_image(0, read=False, write=True)
        self._programs.run(
            self._scan,
            (1,),
            {1: self._counts, 4: self.draw},
            gaussian_count=self._count,
            visible_count=0,
        )
        self._programs.run(
            self._compact,
            (self._blocks,),
            {0: self._keys, 1: self._counts, 2: self._sort.keys, 3: self._sort.indices},
            gaussian_count=self._count,
        )
        self._sort.run(self.draw, into_order=self._targets.order)

    def release(self) -> None:
        self._programs.release()
        self._sort.release()
        for buffer in (self._keys, self._counts, self.draw):
            buffer.release()
