"""Culls and sorts on the GPU, so that a frame uploads nothing and waits for nothing (GL 4.3)."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.camera import Camera
from gscpe.render.context import DriverInfo
from gscpe.render.shader_source import shader_source
from gscpe.render.splatting import SlopeLimits
from gscpe.render.targets import ProjectionTargets

GL_NEEDED = 430

_THREADS = 256
_PER_THREAD = 4
_BLOCK = _THREADS * _PER_THREAD
_SCAN_THREADS = 1024
_DIGIT_BITS = 4
_DIGITS = 1 << _DIGIT_BITS
_PASSES = 32 // _DIGIT_BITS


def pays_on(driver: DriverInfo) -> bool:
    """Whether to sort on this driver's device: a GPU with compute shaders. A driver that runs
    on the CPU would do there, slower, what NumPy does."""
    return not driver.is_software and driver.version_code >= GL_NEEDED


class GpuOrder:
    """Writes the draw order of a splat into its :class:`ProjectionTargets`.

    The order is that of :func:`gscpe.render.visibility_order.depth_order`, reversed, to the bit:
    farthest first; of equal depths the later index first. A least-significant-digit radix sort
    of the depths' bits, 4 bits a pass, of those Gaussians that the image may show.

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
        self._context, self._count, self._near = context, count, near
        self._gaussians, self._targets = gaussians, targets
        self._blocks = -(-count // _BLOCK)
        sizes = {"threads": _THREADS, "per_thread": _PER_THREAD, "block": _BLOCK}
        defines = {name.upper(): value for name, value in (sizes | {"digits": _DIGITS}).items()}
        scan = defines | {"THREADS": _SCAN_THREADS}
        self._programs: list[moderngl.ComputeShader] = []
        self._cull = self._program("cull.comp", defines)
        self._scan_culled = self._program("scan.comp", scan | {"AFTER_CULLING": 1})
        self._compact = self._program("compact.comp", defines)
        self._count_digits = self._program("radix_count.comp", defines)
        self._scan = self._program("scan.comp", scan)
        self._scatter = self._program("radix_scatter.comp", defines)
        self._scatter_last = self._program("radix_scatter.comp", defines | {"LAST_PASS": 1})
        self._counts = context.buffer(reserve=4 * _DIGITS * self._blocks)
        self._keys, self._indices = (
            [context.buffer(reserve=4 * count) for _ in range(2)] for _ in range(2)
        )
        # The arguments of an indirect draw of quads: vertices, instances, three offsets.
        self.draw = context.buffer(np.array([4, 0, 0, 0, 0], dtype=np.uint32).tobytes())

    def _program(self, name: str, defines: dict[str, int]) -> moderngl.ComputeShader:
        program = self._context.compute_shader(shader_source(name, defines))
        self._programs.append(program)
        return program

    def update(self, camera: Camera, cam_from_world: Float64Array) -> None:
        """Queues the work for one view; ``draw`` then holds the number of instances."""
        self._gaussians.use(0)
        _set(
            self._cull,
            gaussian_count=self._count,
            gaussians=0,
            cam_from_world=[tuple(row) for row in cam_from_world[:3]],
            focal=(camera.fx, camera.fy),
            principal=(camera.cx, camera.cy),
            image_size=(camera.width, camera.height),
            stretch=max(camera.fx, camera.fy) * SlopeLimits.of(camera).stretch(),
            near=self._near,
        )
        self._run(self._cull, self._blocks, {0: self._keys[0], 1: self._counts})
        self._targets.visible_count.bind_to_image(0, read=False, write=True)
        _set(self._scan_culled, gaussian_count=self._count, visible_count=0)
        self._run(self._scan_culled, 1, {1: self._counts, 4: self.draw})
        _set(self._compact, gaussian_count=self._count)
        (keys, indices), (keys_out, indices_out) = zip(self._keys, self._indices, strict=True)
        self._run(
            self._compact,
            self._blocks,
            {0: keys, 1: self._counts, 2: keys_out, 3: indices_out},
        )
        for number in range(_PASSES):
            keys, indices, keys_out, indices_out = keys_out, indices_out, keys, indices
            self._pass(number, keys, indices, keys_out, indices_out)

    def _pass(
        self,
        number: int,
        keys: moderngl.Buffer,
        indices: moderngl.Buffer,
        keys_out: moderngl.Buffer,
        indices_out: moderngl.Buffer,
    ) -> None:
        bound = {0: keys, 1: self._counts, 4: self.draw, 5: indices}
        _set(self._count_digits, shift=number * _DIGIT_BITS)
        self._run(self._count_digits, self._blocks, bound)
        self._run(self._scan, 1, bound)
        if number == _PASSES - 1:
            self._targets.order.bind_to_image(0, read=False, write=True)
            _set(self._scatter_last, shift=number * _DIGIT_BITS, order=0)
            self._run(self._scatter_last, self._blocks, bound)
        else:
            _set(self._scatter, shift=number * _DIGIT_BITS)
            self._run(self._scatter, self._blocks, bound | {2: keys_out, 3: indices_out})

    def _run(
        self, program: moderngl.ComputeShader, groups: int, buffers: dict[int, moderngl.Buffer]
    ) -> None:
        for binding, buffer in buffers.items():
            buffer.bind_to_storage_buffer(binding)
        program.run(groups)
        self._context.memory_barrier()

    def release(self) -> None:
        for program in self._programs:
            program.release()
        for buffer in (*self._keys, *self._indices, self._counts, self.draw):
            buffer.release()


def _set(program: moderngl.ComputeShader, **values: Any) -> None:
    for name, value in values.items():
        program[name].value = value
