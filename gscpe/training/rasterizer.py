# SPDX-License-Identifier: Apache-2.0
"""Renders Gaussians as the CPU rasterizer does, and takes gradients back through it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array, Float64Array, IntArray
from gscpe.geometry.camera import Camera
from gscpe.render.cpu_projection import TILE
from gscpe.render.cpu_tiles import Gaussians, TiledView, composite, tile_view
from gscpe.render.kernel_threads import KernelThreads, in_parts
from gscpe.render.view import RenderedView
from gscpe.splats.gaussians import NEAR
from gscpe.training.backward_compositing import SUMS, TOTALS, add_up_entries, sum_tiles
from gscpe.training.backward_projection import GRADIENT, parameter_gradients

_TASK = 4096  # slots; poses' gradients are added up task after task


@dataclass(frozen=True, eq=False)
class ForwardPass:
    """A view and what its backward pass needs.

    Attributes:
        view: the very bits that Renderer(scene, "cpu") gives.
        tiled: the Gaussians that it shows.
    """

    view: RenderedView
    tiled: TiledView


@dataclass(frozen=True, eq=False)
class DepthGradient:
    """The gradient of a loss with respect to ``view.depth``, where it has one.

    Attributes:
        rows, columns: (M,) pixels at which the view has a depth; the same one may come twice.
        values: (M,) float32.
    """

    rows: IntArray
    columns: IntArray
    values: Float32Array


@dataclass(frozen=True, eq=False)
class Gradients:
    """Gradients of a view with respect to the Gaussians that it shows.

    Attributes:
        used: the ranges of slots that hold one.
        keys: (M,) uint64, the lower half of a slot's is the index of its Gaussian.
        by_slot: (M, GRADIENT) float32, see gscpe.training.backward_projection.
        pose: (6,) float64, with respect to xi where the pose is exp(xi) @ cam_from_world.
    """

    used: list[tuple[int, int]]
    keys: NDArray[np.uint64]
    by_slot: Float32Array
    pose: Float64Array


class TrainingRasterizer:
    """Both directions, for arrays that change from one iteration to the next.

    What comes out does not depend on the number of threads, to the last bit.

    Args:
        threads: run the loops.
        antialiased: as in GaussianScene.
        near: the near plane, units of the scene.
    """

    def __init__(
        self, threads: KernelThreads, antialiased: bool = False, near: float = NEAR
    ) -> None:
        self._near = near
        self._threads = threads
        self._antialiased = antialiased
        self._indices = np.zeros(0, dtype=np.uint32)
        self._slot_of = np.zeros(0, dtype=np.int32)

    def forward(
        self,
        gaussians: tuple[Float32Array, Float32Array, Float32Array, Float32Array, Float32Array],
        camera: Camera,
        cam_from_world: Float64Array,
    ) -> ForwardPass:
        """Renders means, quaternions, scales, opacities and sh, arrays as in GaussianScene."""
        count = len(gaussians[0])
        if count != len(self._indices):
            self._indices = np.arange(count, dtype=np.uint32)
            self._slot_of = np.zeros(count, dtype=np.int32)
        whole: Gaussians = (*gaussians, self._indices)
        tiled = tile_view(
            self._threads,
            whole,
            self._indices.astype(np.intp),
            self._slot_of,
            camera,
            cam_from_world,
            self._near,
            self._antialiased,
        )
        return ForwardPass(composite(self._threads, tiled, camera, cam_from_world), tiled)

    def backward(
        self,
        gaussians: tuple[Float32Array, Float32Array, Float32Array, Float32Array, Float32Array],
        forward: ForwardPass,
        rgb_gradient: Float32Array,
        opacity_gradient: Float32Array,
        depth_gradient: DepthGradient | None = None,
    ) -> Gradients:
        """Gradients of a loss with respect to the Gaussians and the pose.

        Args:
            gaussians: those that were rendered.
            forward: how.
            rgb_gradient: (H, W, 3), of the loss with respect to ``view.rgb``.
            opacity_gradient: (H, W), and to ``view.opacity``.
            depth_gradient: and to ``view.depth``, at a few pixels.
        """
        tiled, view = forward.tiled, forward.view
        deep = _by_tile(depth_gradient, forward)
        sums = np.empty((len(tiled.entries), SUMS), dtype=np.float32)
        depth_sums = np.empty(len(tiled.entries), dtype=np.float32)  # mostly never touched
        ends = np.empty(len(tiled.starts) - 1, dtype=np.int64)
        self._threads.run(
            sum_tiles, tiled.tile_parts(), tiled.records, tiled.starts, tiled.entries,
            tiled.columns, view.rgb, view.opacity, rgb_gradient, opacity_gradient,
            *deep, sums, depth_sums, ends,
        )  # fmt: skip
        slots = len(tiled.records)
        totals = np.zeros((slots, TOTALS), dtype=np.float32)
        self._threads.run(
            add_up_entries, in_parts(slots, max(1, -(-slots // self._threads.count))),
            tiled.starts, ends, tiled.entries, deep[0], sums, depth_sums, totals,
        )  # fmt: skip
        tasks = [
            (begin + first, begin + last)
            for begin, end in tiled.used
            for first, last in in_parts(end - begin, _TASK)
        ]
        gradients = np.empty((slots, GRADIENT), dtype=np.float32)
        poses = np.zeros((len(tasks), 6))
        means, quaternions, scales, opacities, sh = gaussians
        self._threads.run(
            parameter_gradients, [(*task, i) for i, task in enumerate(tasks)],
            tiled.records, tiled.keys, totals, means, quaternions, scales, opacities, sh,
            tiled.view, tiled.centre, tiled.intrinsics, tiled.limits, self._antialiased,
            gradients, poses,
        )  # fmt: skip
        return Gradients(tiled.used, tiled.keys, gradients, poses.sum(axis=0))


def _by_tile(
    gradient: DepthGradient | None, forward: ForwardPass
) -> tuple[NDArray[np.int64], NDArray[np.int64], Float32Array, Float32Array]:
    """Where each tile's pixels begin; and of each pixel, tile by tile, where it is in its tile, the
    gradient divided by its opacity, and its depth."""
    tiles = len(forward.tiled.starts) - 1
    if gradient is None:
        nothing = np.zeros(0, dtype=np.float32)
        return np.zeros(tiles + 1, np.int64), np.zeros(0, np.int64), nothing, nothing
    tile = gradient.rows // TILE * forward.tiled.columns + gradient.columns // TILE
    order = np.argsort(tile, kind="stable")
    rows, columns = gradient.rows[order], gradient.columns[order]
    starts = np.searchsorted(tile[order], np.arange(tiles + 1)).astype(np.int64)
    pixels = (rows % TILE * TILE + columns % TILE).astype(np.int64)
    slopes = gradient.values[order] / forward.view.opacity[rows, columns]
    return starts, pixels, slopes.astype(np.float32), forward.view.depth[rows, columns]
