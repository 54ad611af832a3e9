#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Times an iteration of training as a multiple of the forward render of the same view, and shows
how well a splat shows the RedKitchen queries.

Usage: GSCPE_DATA=DATA .venv/bin/python tools/bench_training.py [--splat PLY] [--rounds N]
           [--points N]
       GSCPE_DATA=DATA .venv/bin/python tools/bench_training.py --splat PLY --likeness [--every N]
       GSCPE_DATA=DATA .venv/bin/python tools/bench_training.py --memory PHOTOS

Iteration and render take turns, with the same Gaussians and the same camera, so that whatever
else the machine does falls on both; processor seconds, of all cores, hardly depend on that at
all. The iteration is a whole one: render, loss, gradients, Adam.
The depths of --points points in each photo are regularized; they are those of the splat itself.
The render is Renderer(..., "cpu").render, which is given the Gaussians in view by chunks and not
one by one. PSNR is of renders at the queries' true poses, raw and with a gain and a bias fitted
for each photo and channel. --memory trains a little, with a Gaussian at each of the splat's and so
many photos, the references over and over again, through all that a training does; it tells the most
memory that was taken.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _common import peak_bytes

from gscpe import GaussianScene, Renderer, read_splat
from gscpe.arrays import Float64Array
from gscpe.geometry import se3
from gscpe.geometry.projection import pixel_centres, transform_points, unproject
from gscpe.geometry.spread import evenly_spread
from gscpe.photos import Photo, read_image, to_photo
from gscpe.poses.hloc import read_poses
from gscpe.render.kernel_threads import KernelThreads
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.query_list import read_query_list
from gscpe.splats.gaussians import SH_C0
from gscpe.training import Progress, train
from gscpe.training.checkpoint import TrainingState
from gscpe.training.evaluation import likeness
from gscpe.training.exposure import Exposures
from gscpe.training.parameters import Parameters
from gscpe.training.points import PointCloud, extent_of
from gscpe.training.schedule import Schedule
from gscpe.training.settings import TrainingSettings
from gscpe.training.trainer import Trainer

PHOTOS = 8


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--splat", type=Path, help="default: that of the data set")
    parser.add_argument("--rounds", type=int, default=3, help=f"through {PHOTOS} photos")
    parser.add_argument("--points", type=int, default=0, help="in each photo (default: none)")
    parser.add_argument("--likeness", action="store_true", help="PSNR of the queries")
    parser.add_argument("--memory", type=int, metavar="PHOTOS", help="most memory of a training")
    parser.add_argument("--every", type=int, default=4, help="only every N-th query")
    options = parser.parse_args()
    data = Path(os.environ.get("GSCPE_DATA", "")) / "redkitchen"
    if not data.is_dir():
        print("set GSCPE_DATA to the folder that holds redkitchen/", file=sys.stderr)
        return 2
    scene = read_splat(options.splat or data / "splat.ply")
    if options.likeness:
        show_likeness(scene, data, options.every)
    elif options.memory:
        show_memory(scene, data, options.memory)
    else:
        show_times(scene, data, options.rounds, options.points)
    return 0


def show_likeness(scene: GaussianScene, data: Path, every: int) -> None:
    """PSNR of every so many queries."""
    queries = read_query_list(data / "queries.txt")[::every]
    truth = read_poses(data / "truth.txt")
    photos = [to_photo(read_image(data / "queries" / q.name), q.camera) for q in queries]
    found = likeness(scene, photos, np.stack([truth[q.name] for q in queries]))
    print(
        f"{len(scene)} Gaussians, {len(photos)} queries: PSNR {found.psnr:.2f} dB, "
        f"{found.fitted_psnr:.2f} with gain and bias fitted"
    )


def show_times(scene: GaussianScene, data: Path, rounds: int, points: int) -> None:
    """Milliseconds and ratios, by size of the photos and degree of the colours."""
    references = read_colmap_references(data / "sparse" / "0", data / "references")
    chosen = evenly_spread(len(references), PHOTOS)
    photos = [
        to_photo(read_image(data / "references" / references.names[i]), references.cameras[i])
        for i in chosen
    ]
    extent = extent_of(references.cam_from_world)
    poses = references.cam_from_world[chosen]
    cloud = points_of(scene, photos, poses, points) if points else None
    print(f"{len(scene)} Gaussians, {PHOTOS} views, medians")
    print("| photos | degree | iteration, ms | render, ms | ratio | of processor seconds |")
    print("|---|---|---|---|---|---|")
    for small in (True, False):
        for degree in (0, 3):
            settings = TrainingSettings(
                iterations=10**6, small_share=1.0 if small else 0.0, sh_shares=(2.0, 2.0, 2.0)
            )
            parameters = parameters_of(scene, degree)
            iteration, render = times(parameters, photos, poses, extent, settings, rounds, cloud)
            wall, processor = iteration / render
            print(
                f"| {photos[0].camera.width // (1 + small)} px | {degree} | {iteration[0]:.0f} | "
                f"{render[0]:.0f} | {wall:.2f} | {processor:.2f} |",
                flush=True,
            )
    print(f"at most {peak_bytes() / 1e9:.2f} GB of memory")


def show_memory(scene: GaussianScene, data: Path, count: int) -> None:
    """Gigabytes, of half and whole photos, densification, checkpoints and all."""
    references = read_colmap_references(data / "sparse" / "0", data / "references")
    chosen = np.arange(count) % len(references)
    photos = [
        to_photo(read_image(data / "references" / references.names[i]), references.cameras[i])
        for i in chosen
    ]
    colours = np.clip(255.0 * (0.5 + SH_C0 * scene.sh[:, 0]), 0, 255).astype(np.uint8)
    points = PointCloud(scene.means.astype(np.float64), colours)
    settings = TrainingSettings(iterations=50, densify_rounds=5)
    before = peak_bytes() / 1e9
    told: list[Progress] = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "checkpoint"
        poses = references.cam_from_world[chosen]
        train(photos, poses, points, settings, told.append, file)
    most = max(progress.gaussians for progress in told)
    print(
        f"{count} photos of {photos[0].camera.width}x{photos[0].camera.height}, at most {most} "
        f"Gaussians: {peak_bytes() / 1e9:.2f} GB of memory, {before:.2f} before the training"
    )


def times(
    parameters: Parameters,
    photos: list[Photo],
    poses: Float64Array,
    extent: float,
    settings: TrainingSettings,
    rounds: int,
    cloud: PointCloud | None,
) -> tuple[Float64Array, Float64Array]:
    """Median milliseconds, wall and processor, of an iteration and a render of the same view."""
    state = TrainingState(
        parameters,
        Exposures.neutral(len(photos)),
        Schedule(settings),
        np.zeros(len(parameters), dtype=np.float32),
        np.zeros(len(parameters), dtype=np.int32),
    )
    threads = KernelThreads()
    seen = cloud.seen_in([str(number) for number in range(len(photos))]) if cloud else None
    trainer = Trainer(photos, poses, extent, state, settings, threads, cloud, seen)
    degree = int(np.sqrt(parameters.sh.shape[1])) - 1
    iterations, renders = [], []
    trainer.step()  # compiles
    for number in range(PHOTOS, PHOTOS * (rounds + 1)):
        state.schedule.iteration = number
        index = trainer.photo_of(number)
        camera = trainer.sized(index).camera
        with Renderer(parameters.scene(degree, antialiased=False), "cpu") as renderer:
            renderer.render(camera, poses[index])
            begin = clocks()
            renderer.render(camera, poses[index])
            middle = clocks()
            trainer.step()
            end = clocks()
        renders.append(middle - begin)
        iterations.append(end - middle)
    threads.close()
    return np.median(iterations, axis=0), np.median(renders, axis=0)


def points_of(
    scene: GaussianScene, photos: list[Photo], poses: Float64Array, count: int
) -> PointCloud:
    """So many points of each photo, by number, at random pixels and as deep as the splat."""
    rng = np.random.default_rng(0)
    positions, seen = [], {}
    with Renderer(scene, "cpu") as renderer:
        for number, (photo, pose) in enumerate(zip(photos, poses, strict=True)):
            depth = renderer.render(photo.camera, pose).depth
            chosen = rng.permutation(np.flatnonzero(depth > 0))[:count]
            pixels = pixel_centres(photo.camera).reshape(-1, 2)[chosen]
            in_cam = unproject(photo.camera, pixels, depth.ravel()[chosen].astype(np.float64))
            positions.append(transform_points(se3.inverse(pose), in_cam))
            seen[str(number)] = number * count + np.arange(len(chosen))
    return PointCloud(
        np.concatenate(positions), np.zeros((len(photos) * count, 3), dtype=np.uint8), seen
    )


def clocks() -> Float64Array:
    """Milliseconds on the wall, and of processors."""
    return 1000.0 * np.array([time.perf_counter(), time.process_time()])


def parameters_of(scene: GaussianScene, degree: int) -> Parameters:
    """A splat as if it were being trained."""
    opacities = np.clip(scene.opacities.astype(np.float64), 1e-6, 1.0 - 1e-6)
    return (
        Parameters.new(
            scene.means.copy(),
            np.log(scene.scales),
            scene.quaternions.copy(),
            np.log(opacities / (1.0 - opacities)).astype(np.float32),
            scene.sh.copy(),
        )
        .in_spatial_order()
        .with_degree(degree)
    )


if __name__ == "__main__":
    sys.exit(main())
