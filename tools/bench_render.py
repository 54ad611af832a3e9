#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Times the rasterizers on a map or a splat, as ratios in the same run.

Usage: .venv/bin/python tools/bench_render.py MAP_OR_PLY [--growth] [--plot PNG] [--repeats N]

A whole call is timed: pose in, NumPy arrays (colour, opacity, depth, variance) out. The
rasterizers take turns, so that a change of the machine's speed hits them alike.

--growth: also larger scenes, made by tiling the splat in space. Each scene and rasterizer gets
a process of its own, so that the memory is theirs alone.
--plot: draws the growth with the number of Gaussians and with the image (pip install '.[plots]').
"""

from __future__ import annotations

import argparse
import importlib.util
import multiprocessing
import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Sequence

import numpy as np
from _common import new_figure, peak_bytes, save_figure, table

from gscpe import Camera, GaussianScene, Renderer, open_map, read_splat
from gscpe.arrays import Float64Array
from gscpe.errors import RenderError
from gscpe.render import Renders
from gscpe.render.gl_rasterizer import GlRasterizer
from gscpe.render.visibility_order import VisibilityOrder

SIZES = ((1280, 960), (640, 480), (320, 240), (160, 120))
COUNTS = (100_000, 300_000, 1_000_000, 3_000_000)
PLACES = 3


@dataclass(frozen=True)
class Case:
    """Milliseconds a call, Gaussians in view, and megabytes, of one rasterizer."""

    milliseconds: float
    in_view: int
    megabytes: float


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("splat", type=Path, help="map folder, or .ply")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--growth", action="store_true", help="larger scenes too")
    parser.add_argument("--plot", type=Path, metavar="PNG", help="draw the growth (so --growth)")
    options = parser.parse_args()
    if options.plot and importlib.util.find_spec("matplotlib") is None:
        parser.error("--plot needs matplotlib: pip install '.[plots]'")
    scene, poses = load(options.splat)
    print(f"{len(scene)} Gaussians, harmonics of degree {scene.sh_degree}, {os.cpu_count()} cores")
    sizes = by_size(scene, poses, options.repeats)
    sorting(scene, poses)
    if options.growth or options.plot:
        cases = growth(options.splat, options.repeats)
        if options.plot:
            plot(cases, sizes, options.plot)
    return 0


def load(path: Path) -> tuple[GaussianScene, Float64Array]:
    """The splat, and poses to look at it from, (P, 4, 4)."""
    if path.is_dir():
        map_ = open_map(path)
        poses = map_.references.cam_from_world
        return map_.scene, poses[np.linspace(0, len(poses) - 1, PLACES + 1).astype(int)[:PLACES]]
    scene = read_splat(path)
    return scene, np.stack([_looking_at(scene)])


def by_size(
    scene: GaussianScene, poses: Float64Array, repeats: int
) -> dict[tuple[int, int], dict[str, float]]:
    """Prints and returns milliseconds by size and rasterizer."""
    times: dict[tuple[int, int], dict[str, float]] = {}
    with Renderer(scene, "gl") as gl, Renderer(scene, "cpu") as cpu:
        print(f"gl: {gl.description}; cpu: {cpu.description}\n")
        for size in SIZES:
            values = _time((gl, cpu), _camera(*size), poses, repeats)
            times[size] = dict(zip(("gl", "cpu"), values, strict=True))
    order = VisibilityOrder(scene)
    rows = []
    for size, its in times.items():
        drawn = np.mean([len(order.back_to_front(_camera(*size), pose)) for pose in poses])
        rows.append(
            [f"{size[0]}x{size[1]}", f"{drawn:.0f}", f"{its['gl']:.0f}", f"{its['cpu']:.0f}",
             f"{its['cpu'] / its['gl']:.3f}", f"{its['cpu'] / times[640, 480]['cpu']:.2f}"]
        )  # fmt: skip
    table(["size", "Gaussians in view", "gl, ms", "cpu, ms", "cpu / gl", "cpu, of 640x480"], rows)
    print()
    return times


def sorting(scene: GaussianScene, poses: Float64Array) -> None:
    """Prints whole OpenGL calls with the sort by NumPy and by compute shaders."""
    by_numpy = GlRasterizer(scene, gpu_sort=False)
    try:
        by_gpu = GlRasterizer(scene, gpu_sort=True)
    except RenderError as error:
        print(f"no sort by compute shaders: {error}")
    else:
        numpy_ms, gpu_ms = _time((by_numpy, by_gpu), _camera(320, 240), poses, 5)
        print(f"gl at 320x240, sorted by NumPy {numpy_ms:.0f} ms, by compute shaders {gpu_ms:.0f}")
        by_gpu.close()
    by_numpy.close()
    print()


def growth(path: Path, repeats: int) -> dict[tuple[int, str], Case]:
    """Prints and returns cases by the number of Gaussians and the rasterizer."""
    cases: dict[tuple[int, str], Case] = {}
    processes = multiprocessing.get_context("spawn")
    for count in COUNTS:
        for backend in ("cpu", "gl"):
            with processes.Pool(1) as pool:
                cases[count, backend] = pool.apply(_case, (path, count, backend, repeats))
    rows = []
    for count in COUNTS:
        both = [cases[count, backend] for backend in ("cpu", "gl")]
        rows.append(
            [str(count), str(both[0].in_view), *(f"{case.milliseconds:.0f}" for case in both),
             *(f"{case.megabytes:.0f}" for case in both)]
        )  # fmt: skip
    table(["Gaussians", "in view", "cpu, ms", "gl, ms", "cpu, MB", "gl, MB"], rows)
    print("\n640x480, one view; MB: the most that the process held while it rendered.")
    return cases


def _case(path: Path, count: int, backend: str, repeats: int) -> Case:
    """Measures one rasterizer, in a process that has done nothing else."""
    scene, poses = load(path)
    scene, camera = tiled(scene, count), _camera(640, 480)
    in_view = len(VisibilityOrder(scene).back_to_front(camera, poses[0]))
    _forget_peak_memory()
    with Renderer(scene, backend) as renderer:
        (milliseconds,) = _time((renderer,), camera, poses[:1], repeats)
    return Case(milliseconds, in_view, peak_bytes() / 1e6)


def _forget_peak_memory() -> None:
    """So that loading and tiling do not count; Linux only, without effect elsewhere."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def plot(
    cases: dict[tuple[int, str], Case],
    sizes: dict[tuple[int, int], dict[str, float]],
    path: Path,
) -> None:
    """Time against Gaussians and against pixels, both axes logarithmic."""
    figure, (left, right) = new_figure(2, 9, 3.6)
    for backend, style in (("gl", "s--"), ("cpu", "o-")):
        milliseconds = [cases[count, backend].milliseconds for count in COUNTS]
        _line(left, COUNTS, milliseconds, style, backend)
        ordered = sorted(sizes, key=lambda size: size[0])
        pixels = [width * height for width, height in ordered]
        _line(right, pixels, [sizes[size][backend] for size in ordered], style, backend)
    left.set_xlabel("Gaussians in the splat, 640x480 pixels")
    right.set_xlabel("pixels, whole splat")
    left.set_ylabel("milliseconds a call")
    left.legend()
    save_figure(figure, path)


def _line(axes: Any, x: Sequence[float], y: Sequence[float], style: str, label: str) -> None:
    axes.loglog(x, y, style, label=label)
    for at, value in zip(x, y, strict=True):
        axes.annotate(
            f"{value:.0f}", (at, value), xytext=(0, 6), textcoords="offset points", ha="center"
        )
    axes.grid(visible=True, which="both", alpha=0.25)
    axes.margins(0.1, 0.15)


def tiled(scene: GaussianScene, count: int) -> GaussianScene:
    """A scene of ``count`` Gaussians: a part of the splat, or copies of it side by side."""
    span = np.ptp(np.percentile(scene.means, [1, 99], axis=0), axis=0)
    copies = -(-count // len(scene))
    columns = int(np.ceil(np.sqrt(copies)))
    offsets = [
        np.array([i % columns * span[0], 0.0, i // columns * span[2]], dtype=np.float32)
        for i in range(copies)
    ]
    chosen = np.linspace(0, copies * len(scene) - 1, count).astype(np.int64)
    copy, index = np.divmod(chosen, len(scene))
    return replace(
        scene,
        means=scene.means[index] + np.stack(offsets)[copy],
        quaternions=scene.quaternions[index],
        scales=scene.scales[index],
        opacities=scene.opacities[index],
        sh=scene.sh[index],
    )


def _time(
    renderers: tuple[Renders, ...], camera: Camera, poses: Float64Array, repeats: int
) -> list[float]:
    """Median milliseconds of each renderer, taking turns, after a warm-up."""
    times: list[list[float]] = [[] for _ in renderers]
    for renderer in renderers:
        renderer.render(camera, poses[0])
    for _ in range(repeats):
        for pose in poses:
            for renderer, its_times in zip(renderers, times, strict=True):
                begin = time.perf_counter()
                renderer.render(camera, pose)
                its_times.append(1000.0 * (time.perf_counter() - begin))
    return [float(np.median(its_times)) for its_times in times]


def _camera(width: int, height: int) -> Camera:
    return Camera.pinhole(640, 480, fx=525.5, fy=525.5, cx=320.0, cy=240.0).resized(width, height)


def _looking_at(scene: GaussianScene) -> Float64Array:
    """A camera two spans in front of the middle of a splat."""
    low, high = np.percentile(scene.means, [5, 95], axis=0)
    pose = np.eye(4)
    pose[:3, 3] = -0.5 * (low + high)
    pose[2, 3] += 2.0 * float(np.max(high - low))
    return pose


if __name__ == "__main__":
    sys.exit(main())
