# SPDX-License-Identifier: Apache-2.0
"""Projects and composites on the GPU with compute shaders, tile by tile (GL 4.3).

Blending quads writes each pixel of each Gaussian to memory, several hundred times a pixel. Here a
workgroup holds a tile of the image, takes the Gaussians that touch it front to back, and ends when
nothing shines through. What is read back is what the caller gets, so NumPy has nothing to do.
"""

from __future__ import annotations

from typing import Any, Mapping

import moderngl
import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import RenderError
from gscpe.geometry.camera import Camera
from gscpe.render.context import check_errors
from gscpe.render.gpu_radix import DEFINES, SCAN_THREADS, THREADS, Programs, RadixSort
from gscpe.render.targets import ProjectionTargets
from gscpe.render.view import RenderedView

TILE = 16
MOST_PAIRS = 1 << 25
"""Pairs of a tile and a Gaussian that are listed at most: 512 MB of buffers."""

_FIRST_PAIRS = 1 << 20
_SIZES_KEPT = 4
# Pixels of a thread, and Gaussians fetched together. On an H100, of 1 to 16 and 32 to 256, the
# fastest: 0.15 to 0.20 ms for 640x480 pixels of RedKitchen.
_ROWS, _BATCH = 2, 128
_SPLAT_BYTES = 3 * 16
_TOUCHED_BYTES = 16
_PLANES = 6  # colour, opacity, depth, its variance


class GpuTiles:
    """Draws a splat in the order that :class:`gscpe.render.gpu_sort.GpuOrder` has found.

    Args:
        context: with OpenGL 4.3 or later; it must be current in all calls.
        count: the number of Gaussians.
        sh_count: coefficients of each one's harmonics.
        targets: whose ``order`` is read.
        visible: the buffer whose second number is the length of the order.
    """

    def __init__(
        self,
        context: moderngl.Context,
        count: int,
        sh_count: int,
        targets: ProjectionTargets,
        visible: moderngl.Buffer,
    ) -> None:
        self._context, self._count = context, count
        self._targets, self._visible = targets, visible
        self._programs = Programs(context)
        sizes = {"THREADS": THREADS, "TILE": TILE}
        self._project = self._programs.compile("project.comp", sizes | {"SH_COUNT": sh_count})
        self._scan = self._programs.compile(
            "scan.comp",
            DEFINES | {"THREADS": SCAN_THREADS, "BLOCK": THREADS, "AFTER_PROJECTION": 1},
        )
        self._list = self._programs.compile("tile_list.comp", sizes)
        self._find_starts = self._programs.compile("tile_starts.comp", sizes)
        self._composite = self._programs.compile(
            "tile_composite.comp",
            {"TILE": TILE, "ROWS": _ROWS, "THREAD_ROWS": TILE // _ROWS, "BATCH": _BATCH},
        )
        self._blocks = -(-count // THREADS)
        self._splats = context.buffer(reserve=_SPLAT_BYTES * count)
        self._counts = context.buffer(reserve=4 * self._blocks)
        self._touched = context.buffer(reserve=_TOUCHED_BYTES * THREADS * self._blocks)
        self._pairs = context.buffer(reserve=16)  # how many there are; how many are listed
        self._images: dict[tuple[int, int], _Image] = {}
        self._sort = RadixSort(self._programs, _FIRST_PAIRS)

    def project(self, camera: Camera, values: Mapping[str, Any]) -> None:
        """Queues the projection, with the uniforms of ``projection.glsl``, whose textures are
        bound, and the list of each tile's Gaussians, nearest first."""
        image = self._image(camera.width, camera.height)
        self._targets.order.use(0)
        self._programs.run(
            self._project,
            (self._blocks,),
            {0: self._splats, 1: self._counts, 2: self._touched, 4: self._visible},
            order=0,
            image_size=(camera.width, camera.height),
            **values,
        )
        self._programs.run(
            self._scan,
            (1,),
            {1: self._counts, 4: self._pairs},
            gaussian_count=self._count,
            capacity=self._sort.capacity,
        )
        self._programs.run(
            self._list,
            (-(-self._sort.capacity // THREADS),),
            {
                0: self._sort.keys,
                1: self._counts,
                2: self._touched,
                3: self._sort.indices,
                4: self._pairs,
            },
            blocks=self._blocks,
            columns=image.columns,
        )
        keys, self._listed = self._sort.run(self._pairs, image.tiles.bit_length())
        self._programs.run(
            self._find_starts,
            (self._sort.capacity // THREADS + 1,),
            {0: keys, 2: image.starts, 4: self._pairs},
            tiles=image.tiles,
        )

    def composite(self, camera: Camera) -> None:
        """Queues the picture."""
        image = self._image(camera.width, camera.height)
        self._programs.run(
            self._composite,
            (image.columns, image.rows),
            {
                0: self._splats,
                1: image.starts,
                2: image.planes,
                4: self._pairs,
                5: self._listed,
            },
            image_size=(camera.width, camera.height),
        )

    def read(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView | None:
        """The picture; None where the Gaussians touch more tiles than there was room for."""
        width, height = camera.width, camera.height
        pixels = width * height
        values = np.empty(_PLANES * pixels + 1, dtype=np.float32)
        image = self._image(width, height)
        self._context.copy_buffer(image.host, image.planes)
        image.host.read_into(values)
        self.pairs = int(values[-1:].view(np.uint32)[0])
        if self.pairs > self._sort.capacity:
            return None
        colour, planes = values[: 3 * pixels], values[3 * pixels : -1].reshape(3, height, width)
        return RenderedView(
            rgb=colour.reshape(height, width, 3),
            opacity=planes[0],
            depth=planes[1],
            depth_variance=planes[2],
            camera=camera,
            cam_from_world=cam_from_world.copy(),
        )

    def grow(self) -> bool:
        """Makes room for the pairs of the picture that was read last; False where that would be
        too much."""
        if self.pairs > MOST_PAIRS:
            return False
        self._sort.reserve(min(MOST_PAIRS, self.pairs + self.pairs // 4))
        check_errors(self._context, f"allocating lists of {self._sort.capacity} Gaussians")
        return True

    def _image(self, width: int, height: int) -> _Image:
        """Buffers for this size, kept for the last few sizes."""
        image = self._images.pop((width, height), None)
        if image is None:
            if len(self._images) == _SIZES_KEPT:
                self._images.pop(next(iter(self._images))).release()
            image = _Image(self._context, width, height)
        self._images[width, height] = image
        return image

    def release(self) -> None:
        self._programs.release()
        self._sort.release()
        for image in self._images.values():
            image.release()
        self._images.clear()
        for buffer in (self._splats, self._counts, self._touched, self._pairs):
            buffer.release()


class _Image:
    """Buffers for a picture: its planes, and where each tile's list begins."""

    def __init__(self, context: moderngl.Context, width: int, height: int) -> None:
        self.columns, self.rows = -(-width // TILE), -(-height // TILE)
        self.tiles = self.columns * self.rows
        self.starts = context.buffer(reserve=4 * (self.tiles + 1))
        size = 4 * (_PLANES * width * height + 1)
        self.planes = context.buffer(reserve=size)
        # Drivers move a buffer that is often read to the host's memory (NVIDIA's does), where
        # the shader's scattered writes are slow; so a copy is read.
        self.host = context.buffer(reserve=size, dynamic=True)
        try:
            check_errors(context, f"allocating an image of {width}x{height}")
        except RenderError:
            self.release()
            raise

    def release(self) -> None:
        self.starts.release()
        self.planes.release()
        self.host.release()
