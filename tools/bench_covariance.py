#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Whether errors are as large as their covariances say, on four kinds of scenes.

The normalized error squared averages 6 where covariances are right; more where they promise
too much. Errors of the coarse, the aligned and the final pose stand beside it. Kinds: the real
queries of RedKitchen ($GSCPE_DATA); pictures rendered of its map, darkened and noisy, from poses
that are known exactly; ray-cast rooms in maps of one RGB-D photo, from beside; and the Motorcycle
pair. Without a map, the last two.

Usage: .venv/bin/python tools/bench_covariance.py [MAP] [--queries N] [--plot FILE.png]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Iterator, Sequence

import numpy as np
from _common import (
    Error,
    error_of,
    new_figure,
    read_cases,
    redkitchen,
    save_figure,
    share,
    table,
)
from scipy.stats import chi2

from gscpe import Camera, LocalizationResult, Localizer, open_map
from gscpe.arrays import Float32Array, Float64Array, UInt8Array
from gscpe.demo.motorcycle import load_motorcycle
from gscpe.evaluation import normalized_error_squared
from gscpe.geometry import se3
from gscpe.mapping import map_from_rgbd
from gscpe.scene import Map

STAGES = ("coarse", "aligned", "final")
_DEGREES_OF_FREEDOM = 6
_LARGEST = 30.0
"""Right end of the histograms; what is beyond is counted in their last bar."""
_NOISE = 4.0 / 255.0

View = tuple[UInt8Array, Camera, Float64Array]
"""A photo, its camera, and its true pose."""


def real_queries(data: Path, count: int) -> Iterator[View]:
    for case in read_cases(data, count):
        yield case.image, case.query.camera, case.truth


def rendered_queries(localizer: Localizer, data: Path, count: int) -> Iterator[View]:
    """The map as the queries' cameras see it: what is wrong with real photos and maps is not."""
    rng = np.random.default_rng(0)
    for case in read_cases(data, count):
        view = localizer.render(case.query.camera, case.truth)
        yield degraded(view.rgb, rng), case.query.camera, case.truth


def ray_cast_rooms(count: int) -> Iterator[tuple[Map, list[View]]]:
    """Rooms of the tests, eight photos each, about 10 cm and 3 degrees from the mapped one."""
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
    from scenes import ROOM_POSE, room, room_camera

    camera, rng = room_camera(640, 480), np.random.default_rng(1)
    for seed in range(-(-count // 8)):
        world = room(seed)
        shot = world.shoot(camera, ROOM_POSE, samples=2)
        views = []
        for _ in range(8):
            pose = se3.exp(rng.normal(size=6) * ([0.06] * 3 + [0.03] * 3)) @ ROOM_POSE
            views.append((degraded(world.shoot(camera, pose, samples=2).rgb, rng), camera, pose))
        yield map_from_rgbd(shot.uint8, shot.depth, camera, ROOM_POSE), views


def degraded(rgb: Float32Array | Float64Array, rng: np.random.Generator) -> UInt8Array:
    """A little darker, and noisy."""
    changed = 0.92 * rgb + 0.02 + _NOISE * rng.normal(size=rgb.shape)
    return np.asarray(np.rint(255.0 * np.clip(changed, 0.0, 1.0)), dtype=np.uint8)


class Kind:
    """One kind of scenes: errors and normalized errors by stage."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.lost = 0
        self.normalized: dict[str, list[float]] = {stage: [] for stage in STAGES}
        self.errors: dict[str, list[Error]] = {stage: [] for stage in STAGES}

    def add(self, result: LocalizationResult, truth: Float64Array) -> None:
        if result.cam_from_world is None:
            self.lost += 1
            return
        for stage, found in zip(STAGES, (result.coarse, result.aligned, result), strict=True):
            assert found is not None
            assert found.cam_from_world is not None
            assert found.covariance is not None
            self.normalized[stage].append(
                normalized_error_squared(found.cam_from_world, found.covariance, truth)
            )
            self.errors[stage].append(error_of(found.cam_from_world, truth))

    def rows(self) -> Iterator[list[str]]:
        limit = chi2(_DEGREES_OF_FREEDOM).ppf(0.95)
        for stage, values in self.normalized.items():
            errors = self.errors[stage]
            worse = [
                e.centimetres - c.centimetres
                for e, c in zip(errors, self.errors["coarse"], strict=True)
            ]
            yield [
                f"{self.name}, {stage}",
                str(len(values)),
                f"{np.mean(values):.2f}",
                f"{np.median(values):.2f}",
                share([value <= limit for value in values]),
                _millimetres(errors),
                f"{10 * max(worse):.2f} mm" if stage != "coarse" else "",
            ]


def _millimetres(errors: Sequence[Error]) -> str:
    millimetres = 10.0 * np.median([error.centimetres for error in errors])
    return f"{millimetres:.3f} mm / {np.median([error.degrees for error in errors]):.4f}°"


def measure(map_folder: str | None, count: int) -> list[Kind]:
    kinds = []
    if map_folder is not None:
        data = redkitchen()
        with Localizer(open_map(map_folder)) as localizer:
            for name, views in (
                ("RedKitchen, photos", real_queries(data, count)),
                ("RedKitchen, renders", rendered_queries(localizer, data, -(-count // 4))),
            ):
                kinds.append(Kind(name))
                for image, camera, truth in views:
                    kinds[-1].add(localizer.localize(image, camera), truth)
    kinds.append(Kind("ray-cast rooms"))
    for map_, shots in ray_cast_rooms(-(-count // 4)):
        with Localizer(map_) as localizer:
            for image, camera, truth in shots:
                kinds[-1].add(localizer.localize(image, camera), truth)
    kinds.append(Kind("Motorcycle"))
    pair = load_motorcycle()
    with Localizer(
        map_from_rgbd(pair.left, pair.left_depth, pair.left_camera, np.eye(4))
    ) as localizer:
        kinds[-1].add(localizer.localize(pair.right, pair.right_camera), pair.right_from_left)
    return kinds


def draw(kinds: list[Kind], path: Path) -> None:
    """Histograms of the final poses, and the density that right covariances would give."""
    figure, axes = new_figure(len(kinds), 3.2 * len(kinds), 3.0)
    x, bins = np.linspace(0.0, _LARGEST, 200), np.linspace(0.0, _LARGEST, 16)
    for axis, kind in zip(axes, kinds, strict=True):
        values = np.minimum(kind.normalized["final"], _LARGEST)
        axis.hist(values, bins, density=True, alpha=0.5, label="final poses")
        axis.plot(x, chi2(_DEGREES_OF_FREEDOM).pdf(x), "C1", label="chi squared, 6 d.o.f.")
        axis.set_title(kind.name, fontsize=10)
        axis.set_xlabel("normalized error squared")
    axes[0].set_ylabel("density")
    axes[-1].legend(fontsize=8)
    save_figure(figure, path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", nargs="?", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--queries", type=int, default=100, help="real ones; a quarter of others")
    parser.add_argument("--plot", type=Path, help="picture to write (extra: plots)")
    options = parser.parse_args()
    if options.queries < 1:
        parser.error("--queries must be at least 1")
    kinds = measure(options.map, options.queries)
    headings = ["", "photos", "mean", "median", "below 95% limit", "median error"]
    headings.append("most that a photo is worse than its coarse pose")
    table(headings, (row for kind in kinds for row in kind.rows()))
    for kind in kinds:
        if kind.lost:
            print(f"{kind.name}: {kind.lost} not localized")
    if options.plot:
        draw([kind for kind in kinds if len(kind.errors["final"]) > 1], options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
