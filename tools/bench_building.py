#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Photos looked for in many maps: how long retrieval and opening take, and the memory of it.

Usage: GSCPE_DATA=DATA .venv/bin/python tools/bench_building.py kitchen.gsmap ROOMS_DIR [--maps 20]
       [--photos N] [--memory GB]

The map of RedKitchen is cut into one map less than --maps, which are kept in ROOMS_DIR: each has
some consecutive reference photos, a vocabulary learned from these alone, and the Gaussians that
they show. RedKitchen's photos are then looked for in these, with --memory and without a limit, and
in these and the whole map (in this order, since memory that was once taken is not always given
back). Seconds are those of the processor. The exit status is 0 if every photo that was localized
is within 5 cm and 5 degrees of its true pose.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from _common import Case, error_of, peak_bytes, progress, read_cases, redkitchen, table

from gscpe.batch import Building, OnePhoto, Shelf, shelf_order
from gscpe.geometry.projection import project, transform_points
from gscpe.localization import Localizer
from gscpe.mapping import build_map
from gscpe.scene import Map, open_map, save_map
from gscpe.scene.map_frame import typical_depth
from gscpe.scene.references import References

_FAR = 2.0  # typical depths: what is farther is not of the room
_RIGHT = 5.0, 5.0  # centimetres, degrees


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", help="of RedKitchen")
    parser.add_argument("rooms", help="folder for the maps that are cut out of it")
    parser.add_argument("--maps", type=int, default=20, help="default: %(default)s")
    parser.add_argument("--photos", type=int, default=20, help="default: %(default)s")
    parser.add_argument("--memory", type=float, default=0.5, help="GB (default: %(default)s)")
    options = parser.parse_args()
    data = redkitchen()
    cases = read_cases(data, options.photos)
    folder = Path(options.rooms).absolute()
    rooms = cut(Path(options.map), options.maps - 1, data / "references", folder)
    rows, wrong = [], 0
    for whole, memory in ((False, options.memory), (False, None), (True, None)):
        row, mistakes = look(options.map, whole, rooms, cases, memory)
        rows.append(row)
        wrong += mistakes
    head = ["maps", "limit", "localized", "maps tried", "retrieval, s", "opened", "s to open one"]
    table([*head, "s a photo", "held at most", "memory at most, MB"], rows)
    return 1 if wrong else 0


class TimedShelf(Shelf):
    """Counts which maps it opens, and how long that takes."""

    def __init__(self, *args: object, **more: object) -> None:
        super().__init__(*args, **more)  # type: ignore[arg-type]
        self.opened: Counter[str] = Counter()
        self.seconds = 0.0
        self.most = 0

    def localizer(self, name: str) -> Localizer:
        before, begin = set(self.held), time.process_time()
        localizer = super().localizer(name)
        if name not in before:
            self.opened[name] += 1
            self.seconds += time.process_time() - begin
        self.most = max(self.most, len(self.held))
        return localizer


class TimedBuilding(Building):
    """Measures the retrieval."""

    def __init__(self, shelf: Shelf) -> None:
        super().__init__(shelf)
        self.seconds = 0.0

    def ranked(self, photo: OnePhoto) -> tuple[str, ...]:
        begin = time.process_time()
        ranking = super().ranked(photo)
        self.seconds += time.process_time() - begin
        return ranking


def look(
    map_: str, whole: bool, rooms: list[Path], cases: list[Case], memory: float | None
) -> tuple[list[str], int]:
    """A line of the table, and how many poses are wrong."""
    folders = [*map(str, rooms), *([map_] if whole else [])]
    order = shelf_order(folders, memory=None if memory is None else int(1e9 * memory))
    # Every map has a frame of its own; the rooms' world is the whole map's frame.
    in_map = open_map(map_).frame.cam_from_map
    total, localized, tried, wrong = 0.0, 0, 0, 0
    with TimedShelf(order) as shelf, TimedBuilding(shelf) as building:
        for case in progress(cases, "photos", len(cases)):
            photo = OnePhoto(case.query.name, case.image, case.query.camera)
            begin = time.process_time()
            placed = building.localize(photo)
            total += time.process_time() - begin
            tried += len(placed.tried)
            if placed.found.result is not None and placed.found.localized:
                localized += 1
                truth = in_map(case.truth) if order.folders[placed.map] in rooms else case.truth
                error = error_of(placed.found.result.cam_from_world, truth)
                wrong += not error.within(*_RIGHT)
        opened = sum(shelf.opened.values())
        return [
            f"{len(folders)}",
            "none" if memory is None else f"{memory:g} GB",
            f"{localized} of {len(cases)}, {wrong} wrong",
            f"{tried / len(cases):.1f}",
            f"{building.seconds / len(cases):.2f}",
            f"{len(shelf.opened)} maps, {opened} times",
            f"{shelf.seconds / max(1, opened):.2f}",
            f"{total / len(cases):.2f}",
            f"{shelf.most} maps",
            f"{peak_bytes() / 1e6:.0f}",
        ], wrong


def cut(whole: Path, count: int, images: Path, folder: Path) -> list[Path]:
    """So many maps out of one; those that are there already are kept."""
    map_ = open_map(whole)
    depth = _FAR * typical_depth(map_.scene, map_.references)
    paths = []
    parts = np.array_split(np.arange(len(map_.references)), count)
    for number, part in enumerate(progress(parts, "rooms", count)):
        paths.append(folder / f"room-{number:02d}.gsmap")
        if not paths[-1].is_dir():
            save_map(room(map_, part.tolist(), depth, images), paths[-1])
    return paths


def room(map_: Map, part: list[int], depth: float, images: Path) -> Map:
    """Of some reference photos, whose world is the whole map's frame."""
    all_of_them = map_.references
    references = References(
        tuple(all_of_them.names[i] for i in part),
        all_of_them.cam_from_world[part],
        tuple(all_of_them.cameras[i] for i in part),
    )
    seen = np.zeros(len(map_.scene), dtype=bool)
    for cam_from_world, camera in zip(references.cam_from_world, references.cameras, strict=True):
        points = transform_points(cam_from_world, map_.scene.means.astype(np.float64))
        near = np.flatnonzero((points[:, 2] > 0) & (points[:, 2] < depth))
        pixels = project(camera, points[near])
        seen[near[np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)]] = True
    fields = ("means", "quaternions", "scales", "opacities", "sh")
    scene = replace(map_.scene, **{name: getattr(map_.scene, name)[seen] for name in fields})
    return build_map(scene, references, images)


if __name__ == "__main__":
    sys.exit(main())
