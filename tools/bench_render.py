#!/usr/bin/env python3
"""Times the rasterizers on a map or a splat, as ratios against OpenGL in the same run.

Usage: .venv/bin/python tools/bench_render.py MAP_OR_PLY [--growth] [--repeats N]

A whole call is timed: pose in, NumPy arrays (colour, opacity, depth, variance) out. The
rasterizers take turns, so that a change of the machine's speed hits them alike.

--growth: also larger scenes, made by tiling the splat in space, as a table of time and memory.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from gscpe import Camera, GaussianScene, Renderer, open_map, read_splat
from gscpe.arrays import Float64Array
from gscpe.render.visibility_order import VisibilityOrder

SIZES = ((1280, 960), (640, 480), (320, 240), (160, 120))
COUNTS = (100_000, 300_000, 1_000_000, 3_000_000)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("splat", type=Path, help="map folder, or .ply")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--growth", action="store_true", help="larger scenes too")
    options = parser.parse_args()
    if options.splat.is_dir():
        map_ = open_map(options.splat)
        scene, poses = map_.scene, map_.references.cam_from_world
        poses = poses[np.linspace(0, len(poses) - 1, 4).astype(int)[:3]]
    else:
        scene = read_splat(options.splat)
        poses = np.stack([_looking_at(scene)])
    print(f"{len(scene)} Gaussians, harmonics of degree {scene.sh_degree}, {os.cpu_count()} cores")
    by_size(scene, poses, options.repeats)
    if options.growth:
        growth(scene, poses[:1], options.repeats)
    return 0


def by_size(scene: GaussianScene, poses: Float64Array, repeats: int) -> None:
    with Renderer(scene, "gl") as gl, Renderer(scene, "cpu") as cpu:
        print(f"gl: {gl.description}; cpu: {cpu.description}")
        print()
        print("| size | Gaussians in view | gl, ms | cpu, ms | cpu / gl | cpu, of 640x480 |")
        print("|---|---|---|---|---|---|")
        rows = []
        for width, height in SIZES:
            camera = _camera(width, height)
            drawn = np.mean([len(VisibilityOrder(scene).back_to_front(camera, p)) for p in poses])
            gl_ms, cpu_ms = _time((gl, cpu), camera, poses, repeats)
            rows.append((width, height, drawn, gl_ms, cpu_ms))
        full = next(cpu_ms for width, _, _, _, cpu_ms in rows if width == 640)
        for width, height, drawn, gl_ms, cpu_ms in rows:
            print(
                f"| {width}x{height} | {drawn:.0f} | {gl_ms:.0f} | {cpu_ms:.0f} | "
                f"{cpu_ms / gl_ms:.3f} | {cpu_ms / full:.2f} |"
            )
    print()


def growth(scene: GaussianScene, poses: Float64Array, repeats: int) -> None:
    camera = _camera(640, 480)
    print("| Gaussians | in view | cpu, ms | gl, ms | peak memory so far, MB |")
    print("|---|---|---|---|---|")
    for count in COUNTS:
        larger = tiled(scene, count)
        drawn = len(VisibilityOrder(larger).back_to_front(camera, poses[0]))
        times = {}
        for backend in ("cpu", "gl"):
            with Renderer(larger, backend) as renderer:
                times[backend] = _time((renderer,), camera, poses, repeats)[0]
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"| {count} | {drawn} | {times['cpu']:.0f} | {times['gl']:.0f} | {peak:.0f} |")


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
    renderers: tuple[Renderer, ...], camera: Camera, poses: Float64Array, repeats: int
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
