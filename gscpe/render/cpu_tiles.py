# SPDX-License-Identifier: Apache-2.0
"""From Gaussians to tiles on the CPU: projected, sorted, and listed by the tiles they touch.

The rasterizer composites the lists, and training takes its gradients from the same ones. Needs
Numba.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array, Float64Array, IntArray
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centre
from gscpe.render.cpu_compositing import composite_tiles, fill_entries
from gscpe.render.cpu_projection import RECORD, TILE, project
from gscpe.render.kernel_threads import KernelThreads, in_parts
from gscpe.render.splatting import SlopeLimits
from gscpe.render.view import RenderedView

_TASK = 8192  # Gaussians
_MOST_TASKS = 64  # each counts for every tile

Gaussians = tuple[Any, Any, Any, Any, Any, NDArray[np.uint32]]
"""means, quaternions, scales, opacities and sh as in GaussianScene, and what breaks a tie of
depths: the Gaussians' indices, each below their number."""


@dataclass(frozen=True, eq=False)
class TiledView:
    """The Gaussians that a view shows.

    Attributes:
        records: (M, RECORD) float32, projected Gaussians by slot; not all slots are used.
        used: the ranges of slots that are, in ascending order.
        keys: (M,) uint64; the lower half is the index of the slot's Gaussian.
        starts: (T + 1,) tile i, row by row, holds entries[starts[i]:starts[i + 1]].
        entries: (E,) int32 slots, nearest first in each tile.
        columns, rows: number of tiles.
        view: (3, 4) float32, the pose.
        centre: (3,) float32, the camera's centre.
        intrinsics: (4,) float32, fx, fy, cx, cy.
        limits: (4,) float32, as SlopeLimits.
    """

    records: Float32Array
    used: list[tuple[int, int]]
    keys: NDArray[np.uint64]
    starts: NDArray[np.int64]
    entries: NDArray[np.int32]
    columns: int
    rows: int
    view: Float32Array
    centre: Float32Array
    intrinsics: Float32Array
    limits: Float32Array

    def tile_parts(self) -> list[tuple[int, int]]:
        """Ranges of tiles, of about the same work."""
        return in_parts(self.columns * self.rows, max(1, self.columns // 2))


def tile_view(
    threads: KernelThreads,
    gaussians: Gaussians,
    positions: IntArray,
    slot_of: NDArray[np.int32],
    camera: Camera,
    cam_from_world: Float64Array,
    near: float,
    antialiased: bool,
) -> TiledView:
    """Projects the Gaussians at these positions, sorts them, and lists them by tile.

    Args:
        threads: run it.
        gaussians: see above.
        positions: which may be in view.
        slot_of: room for as many as there are indices; any content.
        camera: pinhole.
        cam_from_world: (4, 4) rigid transform.
        near: Gaussians whose centres are nearer than this are left out.
        antialiased: as in GaussianScene.
    """
    tasks = in_parts(len(positions), max(_TASK, len(positions) // _MOST_TASKS))
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    records = np.empty((len(positions), RECORD), dtype=np.float32)
    tile_rows = np.empty((len(positions), 3), dtype=np.int32)
    keys = np.empty(len(positions), dtype=np.uint64)
    counts = np.zeros((len(tasks), columns * rows), dtype=np.int32)
    limits = SlopeLimits.of(camera)
    view = cam_from_world[:3].astype(np.float32)
    centre = camera_centre(cam_from_world).astype(np.float32)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32)
    done = threads.run(
        project,
        [(*task, i) for i, task in enumerate(tasks)],
        *(positions, *gaussians, view, centre, intrinsics, limits.as_array()),
        np.float32(max(camera.fx, camera.fy) * limits.stretch()),
        np.array([camera.width, camera.height], dtype=np.float32),
        *(np.float32(near), antialiased),
        *(records, records.view(np.uint32), tile_rows, keys, slot_of, counts),
    )
    used = [(begin, end) for (begin, _), (end, _) in zip(tasks, done, strict=True)]
    spans = [task_spans for _, task_spans in done]
    spans_before = np.cumsum([0] + [len(task_spans) for task_spans in spans])
    for slots, before in zip(used, spans_before, strict=False):
        tile_rows[slice(*slots), 2] += before
    nearest_first = np.sort(np.concatenate([keys[slice(*slots)] for slots in used]))
    order = slot_of[nearest_first.astype(np.uint32)]
    starts = np.zeros(columns * rows + 1, dtype=np.int64)
    np.cumsum(counts.sum(axis=0), out=starts[1:])
    entries = np.empty(int(starts[-1]), dtype=np.int32)
    parts = in_parts(rows, -(-rows // threads.count))
    listed = np.concatenate(spans)
    threads.run(fill_entries, parts, order, tile_rows, listed, columns, starts[:-1].copy(), entries)
    return TiledView(
        records, used, keys, starts, entries, columns, rows, view, centre, intrinsics,
        limits.as_array(),
    )  # fmt: skip


def composite(
    threads: KernelThreads, tiled: TiledView, camera: Camera, cam_from_world: Float64Array
) -> RenderedView:
    """The pixels of a tiled view, of this camera and pose."""
    height, width = camera.height, camera.width
    view = RenderedView(
        rgb=np.empty((height, width, 3), dtype=np.float32),
        opacity=np.empty((height, width), dtype=np.float32),
        depth=np.empty((height, width), dtype=np.float32),
        depth_variance=np.empty((height, width), dtype=np.float32),
        camera=camera,
        cam_from_world=cam_from_world.copy(),
    )
    threads.run(
        composite_tiles,
        tiled.tile_parts(),
        tiled.records,
        tiled.starts,
        tiled.entries,
        tiled.columns,
        view.rgb,
        view.opacity,
        view.depth,
        view.depth_variance,
    )
    return view
