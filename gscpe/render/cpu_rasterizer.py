# SPDX-License-Identifier: Apache-2.0
"""Renders a Gaussian splat on the CPU: tiles, exact ellipse binning, vectorized rows.

Needs Numba (``pip install gscpe[cpu]``). On machines without a GPU it is several times
faster than software OpenGL (docs/benchmarks.md).
"""

from __future__ import annotations

import logging
import sys

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array
from gscpe.errors import MissingDependencyError
from gscpe.geometry.camera import Camera
from gscpe.render.kernel_threads import KernelThreads
from gscpe.render.spatial_chunks import SpatialChunks
from gscpe.render.view import RenderedView
from gscpe.splats.gaussians import GaussianScene

_log = logging.getLogger(__name__)

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
            from gscpe.render import cpu_projection, cpu_tiles
        except ImportError as error:
            raise MissingDependencyError(
                f"the CPU rasterizer needs Numba ({error}): pip install 'gscpe[cpu]', or render "
                "with backend='gl'"
            ) from error
        self._tile_view = cpu_tiles.tile_view
        self._composite = cpu_tiles.composite
        self._chunks = SpatialChunks.of(scene)
        order = self._chunks.order.astype(np.uint32)
        self._gaussians = (
            scene.means[order],
            scene.quaternions[order],
            scene.scales[order],
            scene.opacities[order],
            scene.sh[order],
            order,
        )
        self._antialiased = scene.antialiased
        self._near = scene.near
        self._slot_of = np.zeros(len(scene), dtype=np.int32)
        self._threads = KernelThreads(threads)
        self.description = f"CPU rasterizer (Numba), {self._threads.count} threads"
        if not cpu_projection.project.signatures:  # not used in this process yet
            self._compile(progress)

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        tiled = self._tile_view(
            self._threads,
            self._gaussians,
            self._chunks.positions_in_view(camera, cam_from_world),
            self._slot_of,
            camera,
            cam_from_world,
            self._near,
            self._antialiased,
        )
        return self._composite(self._threads, tiled, camera, cam_from_world)

    def _compile(self, progress: bool) -> None:
        """Renders a pixel, so that the loops are compiled, or loaded from Numba's cache, now."""
        camera = Camera.pinhole(1, 1, fx=1.0, fy=1.0, cx=0.5, cy=0.5)
        _log.info("compiling the CPU rasterizer, or loading it from the cache")
        with (
            tqdm(
                total=_KERNELS,
                desc="compiling the CPU rasterizer (once)",
                bar_format="{desc} {bar} {elapsed}",
                leave=False,
                disable=not (progress and sys.stderr),
            ) as bar,
            self._threads.compiling(bar.update),
        ):
            self.render(camera, np.eye(4))

    def close(self) -> None:
        self._threads.close()
