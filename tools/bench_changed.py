#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The whole pipeline on photos that were made darker, overexposed, noisy, partly replaced, ...

Every photo is localized as it is and with each change of ``changed_photos.py``. Prints for each
change how many are localized, the errors of these and their ratio to the errors of the same photos
without a change, whether errors are as large as their covariances say, and the time.

Usage: GSCPE_DATA=DATA .venv/bin/python tools/bench_changed.py MAP [--queries N] [--costly N]
           [--jobs N] [--minutes M] [--only WORD ...] [--left-out] [--half odd|even] [--seed N]
           [--evidence FILE.jsonl] [--report-only] [--images DIR --list FILE --truth FILE]

The photos are RedKitchen's queries of $GSCPE_DATA, or those of --images. With --left-out they are
the map's own reference photos, each localized without itself: what settings are chosen with must
not be reported. Nor must the "odd" half of other photos, where it was used for that.

What is in FILE.jsonl already is not measured again, so that a run may be interrupted, and go on
with more photos: fewer photos are always some of more. Every process has one thread.
"""

from __future__ import annotations

import argparse
import functools
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Iterator, Sequence

import cv2
import numpy as np
from _common import Case, progress, redkitchen
from _evidence import add_lines, in_processes, read_lines
from changed_photos import CHANGES, COSTLY, changed
from changed_report import UNCHANGED, Found, report
from trust_jobs import HALVES, spread

from gscpe import Localizer, open_map, read_image
from gscpe.arrays import UInt8Array
from gscpe.batch.worker import limited_threads
from gscpe.evaluation import normalized_error_squared
from gscpe.geometry import pose_difference, se3
from gscpe.localization.light import well_lit
from gscpe.photos import to_photo
from gscpe.poses import read_pose_file
from gscpe.retrieval import open_describer, search
from gscpe.scene import Map
from gscpe.scene.query_list import Query, read_query_list


@dataclass(frozen=True)
class Photos:
    """Which photos are localized, and in which map.

    Attributes:
        map: folder.
        images: folder of the photos; None: the map's references, left out.
        queries, truth: files.
        backend: of the renderer.
        half: "odd" or "even": every second of them alone.
        seed: of the changes.
    """

    map: str
    images: str
    queries: str | None
    truth: str | None
    backend: str = "cpu"
    half: str | None = None
    seed: int = 0

    def cases(self, map_: Map) -> list[Case]:
        """All photos, unread."""
        if self.queries is None or self.truth is None:
            known = map_.references
            listed = [Query(n, c) for n, c in zip(known.names, known.cameras, strict=True)]
            poses = map_.frame.cam_from_world
            truth = {n: poses(p) for n, p in zip(known.names, known.cam_from_world, strict=True)}
        else:
            listed = list(read_query_list(self.queries))
            truth = dict(read_pose_file(self.truth).poses)
        nothing = np.zeros((0, 0, 3), dtype=np.uint8)
        cases = [Case(q, nothing, truth[q.name]) for q in listed if q.name in truth]
        return cases if self.half is None else cases[HALVES.index(self.half) :: len(HALVES)]

    @property
    def which(self) -> str:
        """What evidence must have been measured with, to count."""
        photos = "references" if self.queries is None else "queries"
        return f"{photos} in {Path(self.map).resolve().name}, seed {self.seed}"


class Localizing:
    """Localizes changed photos in one process.

    Args:
        photos: which.
    """

    def __init__(self, photos: Photos) -> None:
        cv2.setNumThreads(1)
        with limited_threads(1):
            self.map = open_map(photos.map)
            self._localizer = Localizer(self.map, backend=photos.backend)
        self._photos = photos
        self._cases = {case.query.name: case for case in photos.cases(self.map)}
        self._describer = open_describer(self.map.descriptors)
        self(next(iter(self._cases)), UNCHANGED)  # makes what is made once

    def __call__(self, name: str, change: str) -> Found:
        case = self._cases[name]
        image = read_image(Path(self._photos.images) / name)
        if change != UNCHANGED:
            image = changed(image, change, self._photos.seed)
        others = self._others(name, image, case.query) if self._photos.queries is None else None
        began = time.process_time()
        result = self._localizer.localize(image, case.query.camera, references=others)
        seconds = time.process_time() - began
        nan = float("nan")
        unit = 100.0 * (self.map.metres_per_unit or 1.0)
        error = [nan, nan, nan, nan]
        normalized = sigmas = nan
        stages = (result, result.coarse, result.aligned)
        for i, stage in enumerate(stages if result.localized else ()):
            if stage is not None and stage.cam_from_world is not None:
                off = pose_difference(stage.cam_from_world, case.truth)
                error[i], error[3] = unit * off.distance, off.degrees if i == 0 else error[3]
        if result.cam_from_world is not None and result.covariance is not None:
            xi = se3.log(case.truth @ se3.inverse(result.cam_from_world))
            sigmas = float(np.max(np.abs(xi) / np.sqrt(np.diag(result.covariance))))
            normalized = normalized_error_squared(
                result.cam_from_world, result.covariance, case.truth
            )
        final, coarse, aligned, degrees = error
        return Found(
            *(name, change, result.localized, final, degrees, coarse, aligned),
            *(normalized, sigmas, len(result.attempts)),
            *((result.best.matcher or "") if result.best else "", result.reason or "", seconds),
        )

    def _others(self, name: str, image: UInt8Array, query: Query) -> list[str]:
        """The reference photos but for this one, most similar first."""
        photo = well_lit(to_photo(image, query.camera))
        described = self._describer.describe(photo.rgb, None, photo.valid)
        found = search(described, self.map.descriptors.descriptors, 40)
        names = [self.map.references.names[reference.index] for reference in found]
        return [other for other in names if other != name]


@functools.cache
def _localizing(photos: Photos) -> Localizing:
    return Localizing(photos)


def _begin(photos: Photos) -> None:
    """Opens the map, once in each process."""
    _localizing(photos)


def _localize(job: tuple[Photos, str, str]) -> Found:
    photos, name, change = job
    return _localizing(photos)(name, change)


def jobs_of(
    photos: Photos, count: int, costly: int, changes: Sequence[str]
) -> list[tuple[Photos, str, str]]:
    """So many photos with each change, and so many with each of those that take long; a photo after
    the other, evenly spread, so that an interrupted run has seen something of all."""
    names = [case.query.name for case in photos.cases(open_map(photos.map))]
    return [
        (photos, names[i], change)
        for number, i in enumerate(spread(len(names), count))
        for change in changes
        if change not in COSTLY or number < costly
    ]


def measure(
    path: Path, jobs: Sequence[tuple[Photos, str, str]], processes: int, minutes: float
) -> None:
    """Adds a line for each to a file as soon as it is measured; begins none after so long."""
    if not jobs:
        return
    photos = jobs[0][0]
    _begin(photos)  # compiles what is then loaded by all processes
    work = _here(jobs, minutes)
    if processes > 1:
        work = in_processes(_localize, jobs, processes, minutes, _begin, (photos,))
    lines = ({"which": photos.which, **asdict(found)} for found in work)
    add_lines(path, progress(lines, "localize", len(jobs)))


def _here(jobs: Sequence[tuple[Photos, str, str]], minutes: float) -> Iterator[Found]:
    end = time.monotonic() + 60.0 * minutes
    for job in jobs:
        if time.monotonic() > end:
            return
        yield _localize(job)


def read_evidence(path: Path, photos: Photos) -> dict[tuple[str, str], Found]:
    """By photo and change."""
    found = {}
    for line in read_lines(path):
        values: dict[str, Any] = dict(line)
        if values.pop("which", None) == photos.which:
            one = Found(**values)
            found[one.photo, one.change] = one
    return found


def main() -> int:
    options = _options()
    images, listed, truth = options.images, options.list, options.truth
    if images is None:
        data = redkitchen()
        images = str(data / ("references" if options.left_out else "queries"))
        listed, truth = str(data / "queries.txt"), str(data / "truth.txt")
    if options.left_out:
        listed, truth = None, None
    photos = Photos(
        *(options.map, images, listed, truth, options.backend, options.half, options.seed)
    )
    words = options.only or [""]
    changes = [UNCHANGED, *(c for c in CHANGES if any(word in c for word in words))]
    costly = options.queries if options.costly is None else options.costly
    jobs = jobs_of(photos, options.queries, costly, changes)
    with tempfile.TemporaryDirectory() as folder:
        path = options.evidence or Path(folder) / "evidence.jsonl"
        known = read_evidence(path, photos)
        missing = [job for job in jobs if job[1:] not in known]
        if not options.report_only:
            measure(path, missing, options.jobs, options.minutes)
            known = read_evidence(path, photos)
    report([known[job[1:]] for job in jobs if job[1:] in known], changes)
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", help="map folder; of RedKitchen, unless --images is given")
    parser.add_argument("--queries", type=int, default=20, help="so many, evenly spread")
    parser.add_argument(
        "--costly", type=int, help="so many of them with changes that take long (default: all)"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--minutes", type=float, default=np.inf, help="then begin no more")
    parser.add_argument("--only", nargs="+", metavar="WORD", help="changes with one of these words")
    parser.add_argument("--left-out", action="store_true", help="references instead of queries")
    parser.add_argument("--half", choices=sorted(HALVES), help="every second of them alone")
    parser.add_argument("--seed", type=int, default=0, help="of what has moved or come")
    parser.add_argument("--backend", default="cpu", choices=("auto", "gl", "cpu"))
    parser.add_argument("--evidence", type=Path, help="file for a line of JSON a photo and change")
    parser.add_argument("--report-only", action="store_true", help="measure nothing")
    parser.add_argument("--images", help="folder of other photos")
    parser.add_argument("--list", help="of their names and cameras")
    parser.add_argument("--truth", help="of their poses")
    options = parser.parse_args()
    if min(options.queries, options.jobs) < 1 or (options.costly or 0) < 0 or options.seed < 0:
        parser.error("--queries and --jobs must be at least 1, --costly and --seed at least 0")
    if options.images and not (options.left_out or (options.list and options.truth)):
        parser.error("--images needs --list and --truth, or --left-out")
    return options


if __name__ == "__main__":
    sys.exit(main())
