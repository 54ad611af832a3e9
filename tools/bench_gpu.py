#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The figures of tools/bench_gpu.sh: whether OpenGL and the CPU draw the same, what a frame costs
and where its time goes, queries, tracking.

Usage: .venv/bin/python tools/bench_gpu.py {agree,frame,query,track} [MAP_OR_PLY] [--photo PHOTO]

Without a map, a made-up splat of 50 000 Gaussians. Exit status 1: something is not as it must be.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any, Callable

import numpy as np
from bench_render import load

from gscpe import Camera, GaussianScene, Localizer, open_map, read_image
from gscpe.arrays import Float64Array
from gscpe.errors import MissingDependencyError, RenderError
from gscpe.geometry import pose_difference
from gscpe.poses.hloc import read_poses
from gscpe.render.cpu_rasterizer import CpuRasterizer
from gscpe.render.gl_rasterizer import GlRasterizer
from gscpe.render.visibility_order import VisibilityOrder
from gscpe.scene.query_list import read_query_list

CAMERA = Camera.pinhole(640, 480, fx=525.505, fy=525.505, cx=320.0, cy=240.0)
GOAL_MS = 3.0
COLOUR_LIMIT = 1.0 / 255.0
DEPTH_LIMIT = 1e-3
STAGES = {
    "_sort": "cull and sort",
    "_project": "project",
    "_draw": "blend",
    "_read": "read back",
}
TILE_STAGES = {
    "project": "project, list by tile",
    "composite": "composite",
    "read": "read back",
}
"""By method, of the rasterizer and of its tiles."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("agree", "frame", "query", "track"))
    parser.add_argument("splat", type=Path, nargs="?", help="map folder, or .ply")
    parser.add_argument("--photo", type=Path, action="append", default=[], help="for query")
    parser.add_argument("--seconds", type=float, default=5.0, help="for frame: time to spend")
    options = parser.parse_args()
    if options.what == "query":
        return query(options.splat, options.photo)
    if options.what == "track":
        return track(options.splat)
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
    print(
        "| OpenGL | colour, worst | 99.99% | opacity, worst | depth, relative, 99.9% | "
        "order as NumPy's |"
    )
    print("|---|---|---|---|---|---|")
    fine = True
    for name, gl in ways(scene).items():
        same_order = gpu_order_is_right(gl, scene, poses)
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
            f"{255 * opacity:.2f}/255 | {depth:.1e} | "
            f"{ {True: 'yes', False: 'NO', None: '-'}[same_order] } |"
        )
        fine &= (
            colour <= COLOUR_LIMIT
            and worst <= 4 * COLOUR_LIMIT
            and opacity <= 0.01
            and depth <= DEPTH_LIMIT
        )
        fine &= same_order is not False
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


def gpu_order_is_right(gl: GlRasterizer, scene: GaussianScene, poses: Float64Array) -> bool | None:
    """Whether the compute shaders' order holds NumPy's Gaussians, in NumPy's order.

    When culling, half a pixel outside the image, they may round otherwise: one in 10 000.
    """
    if gl._gpu_order is None or gl._context is None:
        return None
    by_numpy = VisibilityOrder(scene)
    right = True
    for pose in poses:
        expected = by_numpy.back_to_front(CAMERA, pose)
        with gl._context:
            gl._gpu_order.update(CAMERA, pose)
            order = gl._projection.read_order()
        common = np.intersect1d(order, expected)
        right &= len(order) + len(expected) - 2 * len(common) <= 1 + len(expected) // 10_000
        right &= bool(
            np.array_equal(order[np.isin(order, common)], expected[np.isin(expected, common)])
        )
    return right


def frame(scene: GaussianScene, poses: Float64Array, seconds: float) -> int:
    """Whole frames, pose in and arrays out; then stage by stage, each waited for."""
    begin = time.perf_counter()
    gl = GlRasterizer(scene)
    gl.render(CAMERA, poses[0])
    print(f"{gl.description}, 640x480; ready after {time.perf_counter() - begin:.2f} s")
    print()
    whole = sample(lambda pose: gl.render(CAMERA, pose), poses, seconds)
    by_stage = staged(gl, poses, seconds)
    gl.close()
    print("| | ms, median | 90% |")
    print("|---|---|---|")
    print(
        f"| a frame, read back, sort included | {statistics.median(whole):.2f} | {p90(whole):.2f} |"
    )
    for stage, values in by_stage.items():
        print(f"| - {stage}, alone | {statistics.median(values):.2f} | {p90(values):.2f} |")
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


def staged(gl: GlRasterizer, poses: Float64Array, seconds: float) -> dict[str, list[float]]:
    """Milliseconds by stage; the GPU is waited for before and after each, so that their sum is
    more than a frame."""
    times: dict[str, list[float]] = defaultdict(list)
    context = gl._context
    assert context is not None

    def timed(stage: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def run(*args: Any, **options: Any) -> Any:
            context.finish()
            begin = time.perf_counter()
            result = call(*args, **options)
            context.finish()
            times[stage].append(1000.0 * (time.perf_counter() - begin))
            return result

        return run

    for holder, stages in ((gl, STAGES), (gl._tiles, TILE_STAGES)):
        for name, stage in stages.items() if holder is not None else ():
            setattr(holder, name, timed(stage, getattr(holder, name)))
    sample(lambda pose: gl.render(CAMERA, pose), poses, seconds)
    return times


def query(folder: Path | None, photos: list[Path]) -> int:
    """Photos of a map, with the truth where GSCPE_DATA holds it."""
    data = Path(os.environ.get("GSCPE_DATA", "/nowhere")) / "redkitchen"
    if folder is None or not (photos or data.is_dir()):
        print("skipped: give a map, and a photo or GSCPE_DATA")
        return 0
    truth = read_poses(data / "truth.txt") if data.is_dir() else {}
    cameras = {q.name: q.camera for q in read_query_list(data / "queries.txt")} if truth else {}
    if not photos:
        photos = sorted((data / "queries").iterdir())
        photos = photos[:: max(1, len(photos) // 5)][:5]
    found = 0
    with Localizer(open_map(folder)) as localizer:
        print(f"rendered by {localizer.renderer_description}")
        print()
        print("| photo | | off the truth | s (second call) | of it |")
        print("|---|---|---|---|---|")
        for photo in photos:
            image, camera = read_image(photo), cameras.get(photo.name, CAMERA)
            localizer.localize(image, camera)
            begin = time.perf_counter()
            result = localizer.localize(image, camera)
            seconds = time.perf_counter() - begin
            found += result.localized
            off = "-"
            if result.cam_from_world is not None and photo.name in truth:
                error = pose_difference(result.cam_from_world, truth[photo.name])
                off = f"{100 * error.distance:.2f} cm / {error.degrees:.3f}°"
            stages = ", ".join(f"{k} {v:.2f}" for k, v in result.seconds.items())
            print(
                f"| {photo.name} | {'localized' if result.localized else result.reason} | {off} | "
                f"{seconds:.2f} | {stages} |"
            )
    return 0 if found == len(photos) else 1


def track(folder: Path | None) -> int:
    """The first photos of GSCPE_DATA as a video, each from the pose of the one before."""
    data = Path(os.environ.get("GSCPE_DATA", "/nowhere")) / "redkitchen"
    if folder is None or not data.is_dir():
        print("skipped: give a map, and GSCPE_DATA")
        return 0
    truth = read_poses(data / "truth.txt")
    queries = [
        q for q in read_query_list(data / "queries.txt") if (data / "queries" / q.name).exists()
    ]
    queries = queries[:10]
    seconds, errors = [], []
    with Localizer(open_map(folder)) as localizer:
        before = None
        for query in queries:
            image = read_image(data / "queries" / query.name)
            begin = time.perf_counter()
            result = localizer.localize(image, query.camera, prior=before)
            seconds.append(time.perf_counter() - begin)
            before = result if result.localized else None
            if result.cam_from_world is not None:
                errors.append(pose_difference(result.cam_from_world, truth[query.name]))
    if len(queries) < 2:
        print("skipped: there are no photos in a row")
        return 0
    cm = [100 * e.distance for e in errors]
    degrees = [e.degrees for e in errors]
    print(
        f"{len(errors)} of {len(queries)} photos localized; "
        f"{1 / statistics.median(seconds[1:]):.1f} a second after the first; "
        f"median {np.median(cm):.2f} cm / {np.median(degrees):.3f}°, worst {max(cm):.2f} cm"
    )
    return 0 if len(errors) == len(queries) else 1


if __name__ == "__main__":
    sys.exit(main())
