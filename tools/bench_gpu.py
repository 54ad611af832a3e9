#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The figures of tools/bench_gpu.sh: whether OpenGL and the CPU draw the same, what a frame costs.

Usage: .venv/bin/python tools/bench_gpu.py {agree,frame} [MAP_OR_PLY]

Without a map, a made-up splat of 50 000 Gaussians. Exit status 1: something is not as it must be.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path
from typing import Any, Callable

import numpy as np
from bench_render import load

from gscpe import Camera, GaussianScene
from gscpe.arrays import Float64Array
from gscpe.errors import MissingDependencyError, RenderError
from gscpe.render.cpu_rasterizer import CpuRasterizer
from gscpe.render.gl_rasterizer import GlRasterizer

CAMERA = Camera.pinhole(640, 480, fx=525.505, fy=525.505, cx=320.0, cy=240.0)
GOAL_MS = 3.0
COLOUR_LIMIT = 1.0 / 255.0
DEPTH_LIMIT = 1e-3


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("agree", "frame"))
    parser.add_argument("splat", type=Path, nargs="?", help="map folder, or .ply")
    parser.add_argument("--seconds", type=float, default=5.0, help="for frame: time to spend")
    options = parser.parse_args()
    scene, poses = load(options.splat) if options.splat else made_up()
    print(f"{len(scene)} Gaussians, harmonics of degree {scene.sh_degree}, {len(poses)} views")
    return agree(scene, poses) if options.what == "agree" else frame(scene, poses, options.seconds)


def made_up() -> tuple[GaussianScene, Float64Array]:
    """Gaussians of all sizes in front of the origin, degree 3, and the pose there."""
    rng = np.random.default_rng(5)
    count = 50_000
    depth = rng.uniform(1.0, 5.0, count)
    quaternions = rng.normal(size=(count, 4))
    sh = rng.normal(0.0, 0.05, (count, 16, 3))
    sh[:, 0] = rng.uniform(-1.5, 1.5, (count, 3))
    scene = GaussianScene(
        means=np.stack([*(rng.uniform(-0.7, 0.7, (2, count)) * depth), depth], 1).astype("f4"),
        quaternions=(quaternions / np.linalg.norm(quaternions, axis=1)[:, None]).astype("f4"),
        scales=np.exp(rng.normal(np.log(0.012), 0.8, (count, 3))).astype("f4"),
        opacities=rng.uniform(0.02, 0.95, count).astype("f4"),
        sh=sh.astype("f4"),
    )
    return scene, np.eye(4)[None]


def agree(scene: GaussianScene, poses: Float64Array) -> int:
    """Every way of OpenGL that the driver has against the CPU rasterizer, at 640x480."""
    try:
        cpu = CpuRasterizer(scene)
    except MissingDependencyError as error:
        print(f"nothing to compare with: {error}")
        return 1
    expected = [cpu.render(CAMERA, pose) for pose in poses]
    cpu.close()
    print()
    print("| OpenGL | colour, worst | 99.99% | opacity, worst | depth, relative, 99.9% |")
    print("|---|---|---|---|---|")
    fine = True
    for name, gl in ways(scene).items():
        views = [gl.render(CAMERA, pose) for pose in poses]
        gl.close()
        # The rim of a Gaussian, at alpha 1/255, may be there for one and not for the other.
        colours = np.abs([a.rgb - b.rgb for a, b in zip(views, expected, strict=True)])
        worst, colour = float(colours.max()), float(np.quantile(colours, 0.9999))
        opacity = max(
            float(np.abs(a.opacity - b.opacity).max()) for a, b in zip(views, expected, strict=True)
        )
        depth = max(
            float(np.quantile((np.abs(a.depth - b.depth) / b.depth)[b.opacity > 0.5], 0.999))
            for a, b in zip(views, expected, strict=True)
        )
        print(
            f"| {name} | {255 * worst:.2f}/255 | {255 * colour:.2f}/255 | "
            f"{255 * opacity:.2f}/255 | {depth:.1e} |"
        )
        fine &= (
            colour <= COLOUR_LIMIT
            and worst <= 4 * COLOUR_LIMIT
            and opacity <= 0.01
            and depth <= DEPTH_LIMIT
        )
    return 0 if fine else 1


def ways(scene: GaussianScene) -> dict[str, GlRasterizer]:
    """The rasterizers with OpenGL that this driver can run."""
    found = {"sorted by NumPy, blended": GlRasterizer(scene, gpu_sort=False)}
    try:
        found["sorted by compute shaders, blended"] = GlRasterizer(
            scene, gpu_sort=True, tiles=False
        )
        found["all by compute shaders"] = GlRasterizer(scene, gpu_sort=True)
    except RenderError as error:
        print(f"no compute shaders: {error}")
    return found


def frame(scene: GaussianScene, poses: Float64Array, seconds: float) -> int:
    """Whole frames, pose in and arrays out."""
    begin = time.perf_counter()
    gl = GlRasterizer(scene)
    gl.render(CAMERA, poses[0])
    print(f"{gl.description}, 640x480; ready after {time.perf_counter() - begin:.2f} s")
    print()
    whole = sample(lambda pose: gl.render(CAMERA, pose), poses, seconds)
    gl.close()
    print("| | ms, median | 90% |")
    print("|---|---|---|")
    print(
        f"| a frame, read back, sort included | {statistics.median(whole):.2f} | {p90(whole):.2f} |"
    )
    print()
    median, software = statistics.median(whole), gl.driver.is_software
    print(
        f"goal: {GOAL_MS:.0f} ms; {'software, so no verdict' if software else f'{median:.2f} ms'}"
    )
    return 0 if software or median <= GOAL_MS else 1


def sample(
    render: Callable[[Float64Array], Any], poses: Float64Array, seconds: float
) -> list[float]:
    """Milliseconds of calls, after a warm-up, for so many seconds but 5 at least."""
    for pose in poses:
        render(pose)
    times: list[float] = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(times) < 5:
        begin = time.perf_counter()
        render(poses[len(times) % len(poses)])
        times.append(1000.0 * (time.perf_counter() - begin))
    return times


def p90(times: list[float]) -> float:
    return float(np.quantile(times, 0.9))


if __name__ == "__main__":
    sys.exit(main())
