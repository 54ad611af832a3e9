#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The whole pipeline on photos that were made darker, overexposed, noisy, partly replaced, ...

Every photo is localized as it is and with each change of ``changed_photos.py``, all in one run.
Prints for each change how many are localized, the errors of these and their ratio to the errors of
the unchanged photos, whether errors are as large as their covariances say, and the time.

Usage: GSCPE_DATA=DATA .venv/bin/python tools/bench_changed.py MAP [--queries N] [--jobs N]
           [--only WORD ...] [--left-out] [--evidence FILE.jsonl]
           [--images DIR --list FILE --truth FILE]

The photos are RedKitchen's queries of $GSCPE_DATA, or those of --images. With --left-out they are
the map's own reference photos, each localized without itself: what settings are chosen with must
not be reported. Every process has one thread.
"""

from __future__ import annotations

import argparse
import functools
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Iterator, Sequence

import cv2
import numpy as np
from _common import Case, progress, redkitchen, table
from changed_photos import CHANGES
from numpy.typing import NDArray
from scipy.stats import chi2

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

UNCHANGED = "unchanged"
_LIMIT = float(chi2(6).ppf(0.95))
_WRONG = 5.0
"""Centimetres, or degrees, beyond which a pose is wrong."""


@dataclass(frozen=True)
class Found:
    """What came of one photo with one change; NaN where there is no pose.

    Attributes:
        photo, change: names.
        localized: whether it was.
        centimetres, degrees: error of the final pose.
        coarse, aligned: error of these poses, centimetres.
        normalized: error squared, by the covariance; 6 on average where that is right.
        sigmas: the largest error along an axis, in its own standard deviations.
        attempts: how many there were.
        matcher: of the attempt that the result comes from.
        reason: why it was not localized.
        seconds: processor time.
    """

    photo: str
    change: str
    localized: bool
    centimetres: float
    degrees: float
    coarse: float
    aligned: float
    normalized: float
    sigmas: float
    attempts: int
    matcher: str
    reason: str
    seconds: float


@dataclass(frozen=True)
class Photos:
    """Which photos are localized, and in which map.

    Attributes:
        map: folder.
        images: folder of the photos; None: the map's references, left out.
        queries, truth: files.
        backend: of the renderer.
    """

    map: str
    images: str
    queries: str | None
    truth: str | None
    backend: str

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
        return [Case(q, nothing, truth[q.name]) for q in listed if q.name in truth]


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
            image = CHANGES[change](image)
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


def _localize(photos: Photos, name: str, change: str) -> Found:
    """In this process, or in another, which opens the map once."""
    return _localizing(photos)(name, change)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", help="map folder; of RedKitchen, unless --images is given")
    parser.add_argument("--queries", type=int, default=20, help="so many, evenly spaced")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--only", nargs="+", metavar="WORD", help="changes with one of these words")
    parser.add_argument("--left-out", action="store_true", help="references instead of queries")
    parser.add_argument("--backend", default="cpu", choices=("auto", "gl", "cpu"))
    parser.add_argument("--evidence", type=Path, help="file for a line of JSON a photo and change")
    parser.add_argument("--images", help="folder of other photos")
    parser.add_argument("--list", help="of their names and cameras")
    parser.add_argument("--truth", help="of their poses")
    options = parser.parse_args()
    if min(options.queries, options.jobs) < 1:
        parser.error("--queries and --jobs must be at least 1")
    images, listed, truth = options.images, options.list, options.truth
    if images is None:
        data = redkitchen()
        images = str(data / ("references" if options.left_out else "queries"))
        listed, truth = str(data / "queries.txt"), str(data / "truth.txt")
    elif not (options.left_out or (listed and truth)):
        parser.error("--images needs --list and --truth, or --left-out")
    if options.left_out:
        listed, truth = None, None
    changes = [
        name for name in CHANGES if not options.only or any(word in name for word in options.only)
    ]
    photos = Photos(options.map, images, listed, truth, options.backend)
    found = []
    with options.evidence.open("w") if options.evidence else nullcontext() as file:
        for one in measure(photos, options.queries, [UNCHANGED, *changes], options.jobs):
            found.append(one)
            if file is not None:
                print(json.dumps(asdict(one)), file=file, flush=True)
    report(found, [UNCHANGED, *changes])
    return 0


def measure(photos: Photos, count: int, changes: Sequence[str], jobs: int) -> Iterator[Found]:
    """Each of so many photos with each change, as they are done."""
    names = [case.query.name for case in photos.cases(open_map(photos.map))]
    chosen = np.unique(np.linspace(0, len(names) - 1, min(count, len(names))).astype(int))
    work = [(photos, names[i], change) for i in chosen for change in changes]
    if jobs == 1:
        yield from progress((_localize(*job) for job in work), "photos", len(work))
        return
    with limited_threads(1), ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        done = as_completed([pool.submit(_localize, *job) for job in work])
        yield from progress((job.result() for job in done), "photos", len(work))


def report(found: Sequence[Found], changes: Sequence[str]) -> None:
    """Prints the table."""
    print(
        f"{len({f.photo for f in found})} photos. Errors: medians over those that are localized. "
        f"Wrong: more than {_WRONG:g} cm or degrees off.\nNEES: normalized error squared, 6 where "
        "covariances are right; and the share below its 95% limit.\n"
        "Time: of a processor, as a multiple of the unchanged photos' median.\n"
    )
    base = [f for f in found if f.change == UNCHANGED]
    rows = [_row(name, [f for f in found if f.change == name], base) for name in changes]
    table(
        ["photos", "localized", "wrong", "coarse cm", "aligned cm", "final", "ratio (cm / °)",
         "rms cm", "NEES mean / median", "below limit", "worst, sigmas", "time: median / mean"],
        rows,
    )  # fmt: skip


def _row(change: str, its: Sequence[Found], base: Sequence[Found]) -> list[str]:
    there = [f for f in its if f.localized]
    wrong = sum(max(f.centimetres, f.degrees) > _WRONG for f in there)
    seconds = np.array([f.seconds for f in its]) / np.median([f.seconds for f in base])
    found, time_taken = (
        f"{len(there)} of {len(its)}",
        f"{_median(seconds):.2f} / {seconds.mean():.2f}",
    )
    if not there:
        return [change, found, str(wrong), *[""] * 8, time_taken]
    nees = np.array([f.normalized for f in there])
    cm, degrees = (_median([getattr(f, of) for f in there]) for of in ("centimetres", "degrees"))
    plain = [f for f in base if f.localized]
    base_cm, base_degrees = (
        _median([getattr(f, of) for f in plain]) for of in ("centimetres", "degrees")
    )
    return [
        *(change, found, str(wrong)),
        *(f"{_median([getattr(f, of) for f in there]):.3f}" for of in ("coarse", "aligned")),
        f"{cm:.3f} cm / {degrees:.3f}°",
        f"{cm / base_cm:.2f} / {degrees / base_degrees:.2f}",
        f"{np.sqrt(np.mean([f.centimetres**2 for f in there])):.3f}",
        f"{nees.mean():.1f} / {_median(nees):.1f}",
        f"{100 * np.mean(nees < _LIMIT):.0f}%",
        f"{max(f.sigmas for f in there):.1f}",
        time_taken,
    ]


def _median(values: Sequence[float] | NDArray[np.float64]) -> float:
    known = np.asarray(values)[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


if __name__ == "__main__":
    sys.exit(main())
