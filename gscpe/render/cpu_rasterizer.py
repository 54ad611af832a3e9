"""Renders a Gaussian splat on the CPU: tiles, exact ellipse binning, vectorized rows.

Needs Numba (``pip install gscpe[cpu]``). On machines without a GPU it is several times
faster than software OpenGL (docs/benchmarks.md).
"""

from __future__ import annotations

import logging
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Callable, Iterable

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array
from gscpe.cores import available_cores
from gscpe.errors import MissingDependencyError
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centre
from gscpe.interrupts import interrupts_later
from gscpe.render.spatial_chunks import SpatialChunks
from gscpe.render.splatting import SlopeLimits
from gscpe.render.view import RenderedView
from gscpe.scene.gaussians import GaussianScene

_log = logging.getLogger(__name__)

_TASK = 8192  # Gaussians
_MOST_TASKS = 64  # each counts for every tile
_KERNELS = 3


def is_available() -> bool:
    """Whether Numba is installed."""
    try:
        import numba  # noqa: F401
    except ImportError:
        return False
    return True


def kept_in() -> str | None:
    """The folder of the compiled loops, or None where each process compiles them.

    Raises:
        ImportError: Numba is not installed.
    """
    from gscpe.render import cpu_projection

    path: str | None = cpu_projection.project.stats.cache_path
    return path


class CpuRasterizer:
    """Implements :class:`gscpe.render.rasterizer.Rasterizer` with compiled loops.

    Raises:
        MissingDependencyError: Numba is not installed.
    """

    def __init__(
        self, scene: GaussianScene, threads: int | None = None, progress: bool = False
    ) -> None:
        try:
            from gscpe.render import cpu_compositing, cpu_projection
        except ImportError as error:
            raise MissingDependencyError(
                f"the CPU rasterizer needs Numba ({error}): pip install 'gscpe[cpu]', or render "
                "with backend='gl'"
            ) from error
        self._tile = cpu_projection.TILE
        self._record = cpu_projection.RECORD
        self._project = cpu_projection.project
        self._fill_entries = cpu_compositing.fill_entries
        self._composite_tiles = cpu_compositing.composite_tiles
        self._chunks = SpatialChunks.of(scene)
        order = self._chunks.order.astype(np.uint32)
        arrays = (scene.means, scene.quaternions, scene.scales, scene.opacities, scene.sh)
        self._gaussians = (*(array[order] for array in arrays), order)
        self._antialiased = scene.antialiased
        self._slot_of = np.zeros(len(scene), dtype=np.int32)
        self._threads = threads or available_cores()
        self._pool: ThreadPoolExecutor | None = None
        self._pool_owner = 0
        self._after_kernel: Callable[[], Any] | None = None
        self.description = f"CPU rasterizer (Numba), {self._threads} threads"
        if not self._project.signatures:  # not used in this process yet
            self._compile(progress)

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        positions = self._chunks.positions_in_view(camera, cam_from_world)
        tasks = _chunks(len(positions), max(_TASK, len(positions) // _MOST_TASKS))
        columns, rows = -(-camera.width // self._tile), -(-camera.height // self._tile)
        records = np.empty((len(positions), self._record), dtype=np.float32)
        tile_rows = np.empty((len(positions), 3), dtype=np.int32)
        keys = np.empty(len(positions), dtype=np.uint64)
        counts = np.zeros((len(tasks), columns * rows), dtype=np.int32)
        limits = SlopeLimits.of(camera)
        done = self._run(
            self._project,
            [(*task, i) for i, task in enumerate(tasks)],
            positions,
            *self._gaussians,
            cam_from_world[:3].astype(np.float32),
            camera_centre(cam_from_world).astype(np.float32),
            np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32),
            limits.as_array(),
            np.float32(max(camera.fx, camera.fy) * limits.stretch()),
            np.array([camera.width, camera.height], dtype=np.float32),
            self._antialiased,
            records,
            records.view(np.uint32),
            tile_rows,
            keys,
            self._slot_of,
            counts,
        )
        used = [slice(begin, end) for (begin, _), (end, _) in zip(tasks, done, strict=True)]
        spans = [task_spans for _, task_spans in done]
        spans_before = np.cumsum([0] + [len(task_spans) for task_spans in spans])
        for slots, before in zip(used, spans_before, strict=False):
            tile_rows[slots, 2] += before
        nearest_first = np.sort(np.concatenate([keys[slots] for slots in used]))
        order = self._slot_of[nearest_first.astype(np.uint32)]
        starts = np.zeros(columns * rows + 1, dtype=np.int64)
        np.cumsum(counts.sum(axis=0), out=starts[1:])
        entries = np.empty(int(starts[-1]), dtype=np.int32)
        self._run(
            self._fill_entries,
            _chunks(rows, -(-rows // self._threads)),
            order,
            tile_rows,
            np.concatenate(spans),
            columns,
            starts[:-1].copy(),
            entries,
        )
        height, width = camera.height, camera.width
        view = RenderedView(
            rgb=np.empty((height, width, 3), dtype=np.float32),
            opacity=np.empty((height, width), dtype=np.float32),
            depth=np.empty((height, width), dtype=np.float32),
            depth_variance=np.empty((height, width), dtype=np.float32),
            camera=camera,
            cam_from_world=cam_from_world.copy(),
        )
        self._run(
            self._composite_tiles,
            _chunks(columns * rows, max(1, columns // 2)),
            records,
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
        self, kernel: Callable[..., Any], parts: Iterable[tuple[int, ...]], *arguments: Any
    ) -> list[Any]:
        """Runs a kernel on all parts; its first arguments say which part."""
        if self._threads == 1 or self._after_kernel is not None:
            results = [kernel(*part, *arguments) for part in parts]
            if self._after_kernel is not None:
                self._after_kernel()
            return results
        if self._pool is None or self._pool_owner != os.getpid():  # threads do not survive a fork
            self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="gscpe-render")
            self._pool_owner = os.getpid()
        futures = [self._pool.submit(kernel, *part, *arguments) for part in parts]
        return [future.result() for future in futures]

    def _compile(self, progress: bool) -> None:
        """Renders a pixel, so that the loops are compiled, or loaded from Numba's cache, now."""
        camera = Camera.pinhole(1, 1, fx=1.0, fy=1.0, cx=0.5, cy=0.5)
        _log.info("compiling the CPU rasterizer, or loading it from the cache")
        with tqdm(
            total=_KERNELS,
            desc="compiling the CPU rasterizer (once)",
            bar_format="{desc} {bar} {elapsed}",
            leave=False,
            disable=not (progress and sys.stderr),
        ) as bar:
            self._after_kernel = bar.update
            with interrupts_later():
                self.render(camera, np.eye(4))
            self._after_kernel = None

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=self._pool_owner == os.getpid())
            self._pool = None


def _chunks(count: int, size: int) -> list[tuple[int, int]]:
    """At least one, so that every kernel runs, and is compiled, whatever is in view."""
    return [(begin, min(begin + size, count)) for begin in range(0, count, size)] or [(0, 0)]
