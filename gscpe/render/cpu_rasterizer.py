"""Renders a Gaussian splat on the CPU: tiles, exact ellipse binning, vectorized rows.

Needs Numba (``pip install gscpe[cpu]``). On machines without a GPU it is several times
faster than software OpenGL (docs/benchmarks.md).
"""

from __future__ import annotations

import logging
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Callable, Iterable

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array
from gscpe.errors import MissingDependencyError
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centre
from gscpe.render.view import RenderedView
from gscpe.render.visibility_order import (
    MIN_ALPHA,
    NEAR,
    SlopeLimits,
    depth_order,
    view_depths,
)
from gscpe.scene.gaussians import GaussianScene

_log = logging.getLogger(__name__)

_CHUNK = 8192
_MOST_CHUNKS = 64
_KERNELS = 4


def is_available() -> bool:
    """Whether Numba is installed."""
    try:
        import numba  # noqa: F401
    except ImportError:
        return False
    return True


class CpuRasterizer:
    """Implements :class:`gscpe.render.rasterizer.Rasterizer` with compiled loops.

    Raises:
        MissingDependencyError: Numba is not installed.
    """

    def __init__(
        self, scene: GaussianScene, threads: int | None = None, progress: bool = False
    ) -> None:
        try:
            from gscpe.render import cpu_kernels
        except ImportError as error:
            raise MissingDependencyError(
                f"the CPU rasterizer needs Numba ({error}): pip install 'gscpe[cpu]', or render "
                "with backend='gl'"
            ) from error
        self._kernels = cpu_kernels
        self._scene = scene
        self._means = np.ascontiguousarray(scene.means.T)
        self._faint = scene.opacities < MIN_ALPHA
        self._threads = threads or _available_cores()
        self._pool: ThreadPoolExecutor | None = None
        self._pool_owner = 0
        self._after_kernel: Callable[[], Any] | None = None
        self.description = f"CPU rasterizer (Numba), {self._threads} threads"
        if not cpu_kernels.project.signatures:  # not used in this process yet
            self._compile(progress)

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        scene, kernels = self._scene, self._kernels
        depths = view_depths(self._means, cam_from_world)
        candidates = np.flatnonzero((depths > NEAR) & ~self._faint)
        depths = depths[candidates]
        records = np.empty((len(candidates), kernels.RECORD), dtype=np.float32)
        tile_rows = np.zeros(len(candidates), dtype=np.int32)
        limits = SlopeLimits.of(camera)
        self._run(
            kernels.project,
            _chunks(len(candidates), _CHUNK),
            candidates,
            depths,
            scene.means,
            scene.quaternions,
            scene.scales,
            scene.opacities,
            scene.sh,
            cam_from_world[:3, :3].astype(np.float32),
            cam_from_world[:3, 3].astype(np.float32),
            camera_centre(cam_from_world).astype(np.float32),
            np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32),
            limits.as_array(),
            np.float32(max(camera.fx, camera.fy) * limits.stretch()),
            np.array([camera.width, camera.height], dtype=np.float32),
            scene.antialiased,
            records,
            tile_rows,
        )
        visible = np.flatnonzero(tile_rows)
        order = visible[depth_order(depths[visible], candidates[visible])]
        return self._composite(order, records, tile_rows, camera, cam_from_world)

    def _composite(
        self,
        order: Any,
        records: Any,
        tile_rows: Any,
        camera: Camera,
        cam_from_world: Float64Array,
    ) -> RenderedView:
        kernels, width, height = self._kernels, camera.width, camera.height
        offsets = np.zeros(len(order) + 1, dtype=np.int64)
        np.cumsum(tile_rows[order], out=offsets[1:])
        columns, rows = -(-width // kernels.TILE), -(-height // kernels.TILE)
        ordered = np.empty((len(order), kernels.RECORD), dtype=np.float32)
        spans = np.empty((int(offsets[-1]), 2), dtype=np.int16)
        size = max(_CHUNK, len(order) // _MOST_CHUNKS)  # each chunk counts for every tile
        chunks = [(i, *chunk) for i, chunk in enumerate(_chunks(len(order), size))]
        counts = np.zeros((len(chunks), columns * rows), dtype=np.int32)
        self._run(
            kernels.find_spans,
            chunks,
            order,
            records,
            offsets,
            width,
            ordered,
            spans,
            counts,
        )
        # Entries are sorted by tile, then by chunk, then by depth within the chunk.
        starts = np.zeros(columns * rows + 1, dtype=np.int64)
        np.cumsum(counts.sum(axis=0), out=starts[1:])
        cursors = starts[:-1] + np.cumsum(counts, axis=0) - counts
        entries = np.empty(int(starts[-1]), dtype=np.int32)
        self._run(kernels.fill_entries, chunks, ordered, offsets, spans, columns, cursors, entries)
        view = RenderedView(
            rgb=np.empty((height, width, 3), dtype=np.float32),
            opacity=np.empty((height, width), dtype=np.float32),
            depth=np.empty((height, width), dtype=np.float32),
            depth_variance=np.empty((height, width), dtype=np.float32),
            camera=camera,
            cam_from_world=cam_from_world.copy(),
        )
        self._run(
            kernels.composite_tiles,
            _chunks(columns * rows, max(1, columns // 2)),
            np.uint64(kernels.TILE),
            ordered,
            starts,
            entries,
            columns,
            view.rgb,
            view.opacity,
            view.depth,
            view.depth_variance,
        )
        return view

    def _run(
        self, kernel: Callable[..., None], parts: Iterable[tuple[int, ...]], *arguments: Any
    ) -> None:
        """Runs a kernel on all parts; its first arguments say which part."""
        if self._threads == 1 or self._after_kernel is not None:
            for part in parts:
                kernel(*part, *arguments)
            if self._after_kernel is not None:
                self._after_kernel()
            return
        if self._pool is None or self._pool_owner != os.getpid():  # threads do not survive a fork
            self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="gscpe-render")
            self._pool_owner = os.getpid()
        for future in [self._pool.submit(kernel, *part, *arguments) for part in parts]:
            future.result()

    def _compile(self, progress: bool) -> None:
        """Renders a pixel, so that the loops are compiled, or loaded from Numba's cache, now."""
        camera = Camera.pinhole(1, 1, fx=1.0, fy=1.0, cx=0.5, cy=0.5)
        _log.info("compiling the CPU rasterizer, or loading it from the cache")
        with tqdm(
            total=_KERNELS,
            desc="compiling the CPU rasterizer (once)",
            bar_format="{desc} {bar} {elapsed}",
            leave=False,
            disable=not progress,
        ) as bar:
            self._after_kernel = bar.update
            self.render(camera, np.eye(4))
            self._after_kernel = None

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=self._pool_owner == os.getpid())
            self._pool = None


def _available_cores() -> int:
    affinity = getattr(os, "sched_getaffinity", None)  # Linux; a container may have fewer
    return len(affinity(0)) if affinity else (os.cpu_count() or 1)


def _chunks(count: int, size: int) -> list[tuple[int, int]]:
    return [(begin, min(begin + size, count)) for begin in range(0, count, size)]
