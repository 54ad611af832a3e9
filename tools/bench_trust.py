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
import sys
import time
from pathlib import Path
from typing import Any, Iterator, Mapping, Sequence

import numpy as np
from _common import progress
from _evidence import add_lines, in_processes, read_lines
from trust_jobs import HALVES, Job, jobs_of, read_places
from trust_report import print_report

from gscpe import Attempt, LocalizationResult, Localizer, open_map, read_image
from gscpe.arrays import Float64Array
from gscpe.errors import CameraError
from gscpe.geometry import pose_difference, se3
from gscpe.geometry.spread import spread_over_image
from gscpe.localization.sigmas import worst_sigmas
from gscpe.localization.wrong_camera import CameraCheckSettings, excess


def read_evidence(path: Path) -> dict[tuple[str, str, str, str], dict[str, Any]]:
    """By map, place of the photo, its name, and camera."""
    lines = read_lines(path)
    return {(line["map"], line["place"], line["name"], line["camera"]): line for line in lines}


class Bench:
    """Measures photos with a localizer for each map."""

    def __init__(self, backend: str) -> None:
        self._backend: str = backend
        self._localizers: dict[Path, Localizer] = {}

    def line(self, each: Job) -> dict[str, Any]:
        folder = each.place.map
        assert folder is not None
        if folder not in self._localizers:
            self._localizers[folder] = Localizer(open_map(folder), backend=self._backend)
        return measured(self._localizers[folder], each)

    def close(self) -> None:
        for localizer in self._localizers.values():
            localizer.close()


_bench: list[Bench] = []
"""That of a process which was started for ``--jobs``."""


def _begin(backend: str) -> None:
    _bench.append(Bench(backend))


def _line(each: Job) -> dict[str, Any]:
    return _bench[0].line(each)


def measure(path: Path, jobs: Sequence[Job], processes: int, minutes: float, backend: str) -> None:
    """Adds a line for each to a file as soon as it is measured; begins none after so long."""
    if not jobs:
        return
    work = _here(jobs, minutes, backend)
    if processes > 1:
        work = in_processes(_line, jobs, processes, minutes, _begin, (backend,))
    add_lines(path, progress(work, "localize", len(jobs)))


def _here(jobs: Sequence[Job], minutes: float, backend: str) -> Iterator[dict[str, Any]]:
    end = time.monotonic() + 60.0 * minutes
    bench = Bench(backend)
    try:
        for each in jobs:
            if time.monotonic() > end:
                return
            yield bench.line(each)
    finally:
        bench.close()


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
            "spread": spread_over_image(coarse.inlier_pixels, result.camera),
            "camera": excess(coarse, result.camera, CameraCheckSettings()),
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
    parser.add_argument("--minutes", type=float, default=np.inf, help="then begin no more")
    parser.add_argument("--backend", choices=("auto", "gl", "cpu"), default="auto", help="renderer")
    parser.add_argument("--half", choices=sorted(HALVES), help="this half alone")
    parser.add_argument("--report-only", action="store_true", help="measure nothing")
    options = parser.parse_args()
    places = read_places(options.places)
    jobs = jobs_of(places, options.right, options.estimated, options.foreign, options.half)
    known = read_evidence(options.evidence)
    missing = [each for each in jobs if each.key not in known]
    if missing and not options.report_only:
        measure(options.evidence, missing, options.jobs, options.minutes, options.backend)
        known = read_evidence(options.evidence)
    lines = list(wanted(known, jobs))
    if len(lines) < len(jobs):
        print(f"Not measured yet: {len(jobs) - len(lines)} of {len(jobs)}\n")
    print_report([place.name for place in places if place.map is not None], lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
