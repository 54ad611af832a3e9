#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Whether poses and their covariances can be trusted, on several places with a map each.

Localizes photos with a known pose in the map of their own place, and the photos of every place
in the maps of all others, with everything that is tried by default. Prints, for each place, how
many are localized, how many of them wrongly or in the map of another place, what separates the
two, and the normalized errors (docs/benchmarks.md, Trust).

Usage: .venv/bin/python tools/bench_trust.py PLACES.toml --evidence FILE.jsonl [--right N]
           [--estimated N] [--foreign N] [--half odd|even] [--jobs N] [--minutes M]

PLACES.toml has a table for each place; paths are with respect to the file:

    [[place]]
    name = "kitchen"
    map = "kitchen.gsmap"          # none: its photos are only tried in the others' maps
    images = "kitchen/queries"
    queries = "kitchen/queries.txt"  # lines of: name MODEL width height params
    truth = "kitchen/truth.txt"    # only photos with a pose here are tried in their own map

Every second photo is for choosing settings ("odd"), the others are reported ("even"): --half takes
one kind alone. What is in FILE.jsonl already is not measured again, so that a run may
be interrupted, and go on with more photos: fewer photos are always some of more.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
import tomllib
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, Iterator, Mapping, Sequence

import numpy as np
from _common import progress
from trust_report import print_report

from gscpe import Attempt, LocalizationResult, Localizer, open_map, read_image
from gscpe.arrays import Float64Array
from gscpe.errors import CameraError
from gscpe.geometry import pose_difference, se3
from gscpe.localization.verification import focal_contradiction, inlier_spread, worst_sigmas
from gscpe.poses import read_pose_file
from gscpe.scene.query_list import Query, read_query_list

HALVES = ("even", "odd")
"""Reported, and for choosing settings."""
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True, eq=False)
class Place:
    """Photos of one place, and perhaps a map of it."""

    name: str
    map: Path | None
    images: Path
    queries: tuple[Query, ...]
    truth: Mapping[str, Float64Array]


@dataclass(frozen=True, eq=False)
class Job:
    """One photo to localize in one map.

    Attributes:
        place: whose map.
        photos: the place that the photo shows.
        query: the photo.
        camera: "given", or "estimated" from the photo alone.
        half: "odd" or "even", see :func:`halves`.
    """

    place: Place
    photos: Place
    query: Query
    camera: str
    half: str

    @property
    def key(self) -> tuple[str, str, str, str]:
        return self.place.name, self.photos.name, self.query.name, self.camera


def read_places(path: Path) -> list[Place]:
    folder = path.resolve().parent
    return [
        Place(
            entry["name"],
            folder / entry["map"] if "map" in entry else None,
            folder / entry["images"],
            read_query_list(folder / entry["queries"]),
            read_pose_file(folder / entry["truth"]).poses if "truth" in entry else {},
        )
        for entry in tomllib.loads(path.read_text())["place"]
    ]


def spread(count: int, number: int) -> list[int]:
    """So many of ``range(count)``, spread evenly; fewer of them are always some of more."""
    return sorted(range(count), key=lambda i: (i * _GOLDEN) % 1.0)[:number]


def jobs_of(
    places: Sequence[Place], right: int, estimated: int, foreign: int, half: str | None = None
) -> list[Job]:
    """Those of the maps in turns, so that an interrupted run has seen something of each."""
    by_map: list[list[Job]] = []
    for place in places:
        if place.map is None:
            continue
        own = [i for i in of_half(place, half) if place.queries[i].name in place.truth]
        queues = [
            [job(place, place, own[i], camera) for i in spread(len(own), number)]
            for number, camera in ((right, "given"), (estimated, "estimated"))
        ]
        for other in places:
            if other is not place:
                theirs = of_half(other, half)
                chosen = spread(len(theirs), foreign)
                queues.append([job(place, other, theirs[i], "given") for i in chosen])
        by_map.append(in_turns(queues))
    return in_turns(by_map)


def halves(place: Place) -> list[str]:
    """Of each photo, by its number among those with a true pose, or among the others: where a map
    leaves out every eighth photo, their numbers in the list are all of one kind."""
    counts = {True: 0, False: 0}
    found = []
    for query in place.queries:
        known = query.name in place.truth
        found.append(HALVES[counts[known] % 2])
        counts[known] += 1
    return found


def of_half(place: Place, half: str | None) -> list[int]:
    """Numbers of the place's photos of this half, or of all."""
    return [i for i, its in enumerate(halves(place)) if half in (None, its)]


def in_turns(queues: Sequence[Sequence[Job]]) -> list[Job]:
    """The first of each queue, then the second of each."""
    return [each for turn in zip_longest(*queues) for each in turn if each is not None]


def job(place: Place, photos: Place, index: int, camera: str) -> Job:
    return Job(place, photos, photos.queries[index], camera, halves(photos)[index])


def read_evidence(path: Path) -> dict[tuple[str, str, str, str], dict[str, Any]]:
    """By map, place of the photo, its name, and camera."""
    if not path.is_file():
        return {}
    known = {}
    for text in path.read_text().splitlines():
        try:
            line = json.loads(text)
        except ValueError:
            continue  # the run was killed while it wrote this line: it is measured again
        known[line["map"], line["place"], line["name"], line["camera"]] = line
    return known


class Bench:
    """Measures photos with a localizer for each map."""

    def __init__(self) -> None:
        self._localizers: dict[Path, Localizer] = {}

    def line(self, each: Job) -> dict[str, Any]:
        assert each.place.map is not None
        localizer = self._localizers.get(each.place.map)
        if localizer is None:
            localizer = self._localizers[each.place.map] = Localizer(open_map(each.place.map))
        return measured(localizer, each)

    def close(self) -> None:
        for localizer in self._localizers.values():
            localizer.close()


_bench: Bench | None = None
"""Of a process that a run with ``--jobs`` has started."""


def _begin() -> None:
    global _bench
    _bench = Bench()


def _line(each: Job) -> dict[str, Any]:
    assert _bench is not None
    return _bench.line(each)


def measure(path: Path, jobs: Sequence[Job], processes: int, minutes: float) -> None:
    """Adds a line for each to a file as soon as it is measured; begins none after so long."""
    if not jobs:
        return
    path.touch()
    with path.open("a") as output:
        output.write(_newline_if_cut_off(path))
        work = _beside(jobs, processes, minutes) if processes > 1 else _here(jobs, minutes)
        for line in progress(work, "localize", len(jobs)):
            output.write(json.dumps(line) + "\n")
            output.flush()


def _here(jobs: Sequence[Job], minutes: float) -> Iterator[dict[str, Any]]:
    bench, end = Bench(), time.monotonic() + 60.0 * minutes
    try:
        for each in jobs:
            if time.monotonic() > end:
                return
            yield bench.line(each)
    finally:
        bench.close()


def _beside(jobs: Sequence[Job], processes: int, minutes: float) -> Iterator[dict[str, Any]]:
    """In so many processes of one thread each, in the order in which they are done."""
    for library in ("GSCPE", "OMP", "OPENBLAS"):
        os.environ[f"{library}_NUM_THREADS" if library != "GSCPE" else "GSCPE_THREADS"] = "1"
    context = multiprocessing.get_context("spawn")
    end = time.monotonic() + 60.0 * minutes
    waiting = iter(jobs)
    with ProcessPoolExecutor(processes, context, _begin) as pool:
        running: set[Future[dict[str, Any]]] = set()
        while True:
            while len(running) < 2 * processes and time.monotonic() < end:
                each = next(waiting, None)
                if each is None:
                    break
                running.add(pool.submit(_line, each))
            if not running:
                return
            done = next(as_completed(running))
            running.remove(done)
            yield done.result()


def _newline_if_cut_off(path: Path) -> str:
    """So that what follows a line whose writing was interrupted has a line of its own."""
    text = path.read_text()
    return "\n" if text and not text.endswith("\n") else ""


def measured(localizer: Localizer, each: Job) -> dict[str, Any]:
    """Everything that the report may ask about one photo."""
    image = read_image(each.photos.images / each.query.name)
    line: dict[str, Any] = {
        "map": each.place.name,
        "place": each.photos.name,
        "name": each.query.name,
        "camera": each.camera,
        "half": each.half,
    }
    camera = each.query.camera
    if each.camera == "estimated":
        try:
            camera = localizer.estimate_camera(image)
        except CameraError as error:
            return line | {"localized": False, "reason": str(error), "attempts": []}
        line["focal_error"] = camera.fx / each.query.camera.fx - 1.0
        line["focal_sigma"] = camera.focal_sigma
    result = localizer.localize(image, camera)
    line |= {
        "localized": result.localized,
        "reason": result.reason,
        "seconds": result.seconds,
        "attempts": [of_attempt(attempt, result) for attempt in result.attempts],
    }
    if each.place is each.photos:
        line["stages"] = of_stages(result, each.place.truth[each.query.name])
    if result.best is not None and result.localized:
        assert result.best.aligned is not None
        # Metres for surfaces two metres away.
        line["unit"] = result.best.aligned.tolerance_unit * localizer.map.frame.scale
        line["best"] = result.attempts.index(result.best)
    return line


def of_attempt(attempt: Attempt, result: LocalizationResult) -> dict[str, Any]:
    """All that verification looks at; what a stage did not give is missing."""
    evidence: dict[str, Any] = {
        "matcher": attempt.matcher,
        "orientation": attempt.orientation,
        "reference": attempt.start.reference,
        "doubt": attempt.doubt,
    }
    coarse, aligned = attempt.coarse, attempt.aligned
    if coarse is not None:
        evidence |= {
            "inliers": coarse.inliers,
            "matches": coarse.matches,
            "inlier_share": coarse.inliers / max(coarse.matches, 1),
            "spread": inlier_spread(coarse.inlier_pixels, result.camera),
            "focal": focal_contradiction(coarse, result.camera),
        }
    if aligned is not None and aligned.cam_from_world is not None:
        assert aligned.covariance is not None
        sigma, degrees = worst_sigmas(aligned.covariance, aligned.tolerance_unit)
        evidence |= {
            "agreement": None if np.isnan(aligned.agreement) else aligned.agreement,
            "overlap": aligned.overlap,
            "sigma": sigma,
            "sigma_degrees": degrees,
        }
        if coarse is not None and coarse.cam_from_world is not None:
            shift = pose_difference(aligned.cam_from_world, coarse.cam_from_world)
            evidence |= {
                "shift": shift.distance * aligned.tolerance_unit,
                "shift_degrees": shift.degrees,
            }
    return evidence


def of_stages(result: LocalizationResult, truth: Float64Array) -> dict[str, Any]:
    """Errors of each pose, and the covariances that come with them."""
    stages = {}
    for name, stage in (("coarse", result.coarse), ("aligned", result.aligned), ("final", result)):
        if stage is None or stage.cam_from_world is None or stage.covariance is None:
            continue
        error = pose_difference(stage.cam_from_world, truth)
        stages[name] = {
            "error": error.distance,
            "degrees": error.degrees,
            "xi": se3.log(truth @ se3.inverse(stage.cam_from_world)).tolist(),
            "covariance": stage.covariance.tolist(),
        }
    return stages


def wanted(lines: Mapping[Any, dict[str, Any]], jobs: Sequence[Job]) -> Iterator[dict[str, Any]]:
    return (lines[each.key] for each in jobs if each.key in lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("places", type=Path, help="TOML file, see the head of this tool")
    parser.add_argument("--evidence", type=Path, required=True, help="file of JSON lines")
    parser.add_argument("--right", type=int, default=100, help="photos a map, of its own place")
    parser.add_argument("--estimated", type=int, default=25, help="... with estimated cameras")
    parser.add_argument("--foreign", type=int, default=34, help="photos a map and other place")
    parser.add_argument("--jobs", type=int, default=1, help="processes, of one thread each")
    parser.add_argument(
        "--minutes", type=float, default=np.inf, help="begin no photo after so many"
    )
    parser.add_argument("--half", choices=sorted(HALVES), help="this half alone")
    parser.add_argument("--report-only", action="store_true", help="measure nothing")
    options = parser.parse_args()
    places = read_places(options.places)
    jobs = jobs_of(places, options.right, options.estimated, options.foreign, options.half)
    known = read_evidence(options.evidence)
    missing = [each for each in jobs if each.key not in known]
    if missing and not options.report_only:
        measure(options.evidence, missing, options.jobs, options.minutes)
        known = read_evidence(options.evidence)
    lines = list(wanted(known, jobs))
    if len(lines) < len(jobs):
        print(f"Not measured yet: {len(jobs) - len(lines)} of {len(jobs)}\n")
    print_report([place.name for place in places if place.map is not None], lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
