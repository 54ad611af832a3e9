#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Shows what separates right poses from wrong ones, on RedKitchen ($GSCPE_DATA).

Localizes the queries, some of them half covered or dark and blurred, and photos of other
places, all without thresholds; and refines queries from priors beside the truth. Prints how
many the thresholds of VerificationSettings let pass, and how far each lies from either kind
(docs/how-it-works.md, Verification).

Usage: .venv/bin/python tools/bench_verification.py MAP --evidence FILE.jsonl [--matcher NAME]
           [--queries N] [--changed-every N] [--tracked N] [--hypotheses N] [--plot FILE.png]

A photo takes one to three seconds on two cores. What is in FILE.jsonl already is not measured
again.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Iterable, Mapping

import numpy as np
from _common import progress, read_queries, redkitchen
from _evidence import add_lines, read_lines
from verification_photos import Sample, of_elsewhere, of_redkitchen
from verification_report import TRACKING, plot_roc, print_report

from gscpe import LocalizationResult, Localizer, LocalizerSettings, open_map
from gscpe.arrays import Float64Array
from gscpe.geometry import pose_difference, se3
from gscpe.geometry.spread import spread_over_image
from gscpe.localization import Attempt, VerificationSettings
from gscpe.localization.verification import compare_stages
from gscpe.photos import to_photo
from gscpe.poses import read_pose_file
from gscpe.refinement import RefinementResult, refine_pose
from gscpe.scene import MapFrame

NO_THRESHOLDS = VerificationSettings(
    min_inliers=0,
    min_inlier_share=0.0,
    min_spread=0.0,
    min_agreement=-1.0,
    min_overlap=0.0,
    max_shift=np.inf,
    max_shift_degrees=np.inf,
    max_sigma=np.inf,
    max_sigma_degrees=np.inf,
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--evidence", type=Path, required=True, help="file of JSON lines")
    parser.add_argument("--matcher", default="auto", metavar="NAME", help="as gscpe localize has")
    parser.add_argument("--queries", type=int, default=100, help="so many, evenly spaced")
    parser.add_argument("--changed-every", type=int, default=3, help="every N-th is changed too")
    parser.add_argument("--tracked", type=int, default=40, help="queries to refine from priors")
    parser.add_argument("--hypotheses", type=int, default=1, help="places tried a photo")
    parser.add_argument("--plot", type=Path, help="picture of the ROC curves (extra: plots)")
    options = parser.parse_args()
    data = redkitchen()
    queries, tracked = (read_queries(data, n) for n in (options.queries, options.tracked))
    truth = read_pose_file(data / "truth.txt").poses
    samples = [
        *of_redkitchen(data, queries, truth, options.changed_every),
        *of_elsewhere(data, queries, options.changed_every),
        *(replace(s, kind=TRACKING) for s in of_redkitchen(data, tracked, truth, 0)),
    ]
    known = read_evidence(options.evidence)
    missing = [sample for sample in samples if (sample.kind, sample.name) not in known]
    settings = LocalizerSettings(hypotheses=options.hypotheses, verification=NO_THRESHOLDS)
    if missing:
        with Localizer(open_map(options.map), settings, options.matcher) as localizer:
            measure(localizer, missing, options.evidence)
        known = read_evidence(options.evidence)
    lines = [known[sample.kind, sample.name] for sample in samples]
    print_report(lines, VerificationSettings())
    if options.plot is not None:
        plot_roc(lines, VerificationSettings(), options.plot)
    return 0


def read_evidence(path: Path) -> dict[tuple[str, str], Mapping[str, Any]]:
    """By kind and name of the photo."""
    return {(line["kind"], line["name"]): line for line in read_lines(path)}


def measure(localizer: Localizer, samples: Iterable[Sample], path: Path) -> None:
    """Adds a line a sample to the file."""
    add_lines(path, (line_of(localizer, each) for each in progress(samples, "localize")))


def line_of(localizer: Localizer, sample: Sample) -> dict[str, Any]:
    if sample.kind == TRACKING:
        evidence = [aligned_from_beside(localizer, sample)]
    else:
        result = localizer.localize(sample.load(), sample.camera)
        evidence = [of_attempt(a, sample, localizer.settings) for a in result.attempts]
    return {
        "kind": sample.kind,
        "name": sample.name,
        "elsewhere": sample.truth is None,
        "attempts": evidence,
    }


def of_attempt(attempt: Attempt, sample: Sample, settings: LocalizerSettings) -> dict[str, Any]:
    """All that verification looks at; what a stage did not give is missing."""
    coarse, aligned = attempt.coarse, attempt.aligned
    assert coarse is not None
    evidence: dict[str, Any] = {
        "inliers": coarse.inliers,
        "inlier_share": coarse.inliers / max(coarse.matches, 1),
        "spread": spread_over_image(coarse.inlier_pixels, sample.camera),
    }
    if aligned is not None and aligned.cam_from_world is not None:
        found = compare_stages(coarse, aligned, VerificationSettings(), settings.fusion)
        evidence |= of_aligned(aligned, coarse.cam_from_world) | asdict(found)
    at_first = errors(coarse.cam_from_world, sample)
    evidence |= {f"coarse_{name}": value for name, value in at_first.items()}
    final = LocalizationResult.of([attempt], sample.camera, MapFrame(), settings, {}).cam_from_world
    return evidence | errors(final, sample)


def of_aligned(
    aligned: RefinementResult, start_cam_from_world: Float64Array | None
) -> dict[str, Any]:
    if aligned.cam_from_world is None or aligned.covariance is None or start_cam_from_world is None:
        return {}
    unit = aligned.tolerance_unit
    shift = pose_difference(aligned.cam_from_world, start_cam_from_world)
    translation, rotation = (
        float(np.sqrt(max(np.linalg.eigvalsh(block)[-1], 0.0)))
        for block in (aligned.covariance[:3, :3], aligned.covariance[3:, 3:])
    )
    return {
        "agreement": None if np.isnan(aligned.agreement) else aligned.agreement,
        "overlap": aligned.overlap,
        "shift": shift.distance * unit,
        "shift_degrees": shift.degrees,
        "sigma": translation * unit,
        "sigma_degrees": float(np.degrees(rotation)),
        "converged": bool(aligned.converged),
    }


def errors(cam_from_world: Float64Array | None, sample: Sample) -> dict[str, float]:
    if cam_from_world is None or sample.truth is None:
        return {}
    error = pose_difference(cam_from_world, sample.truth)
    return {"error": error.distance, "error_degrees": error.degrees}


def aligned_from_beside(localizer: Localizer, sample: Sample) -> dict[str, Any]:
    """As tracking does, from a prior that is 0.1 m and 3 degrees to 0.6 m and 20 degrees off,
    more often near than far."""
    assert sample.truth is not None
    rng = np.random.default_rng(zlib.crc32(sample.name.encode()))
    step = rng.normal(size=6)
    far = rng.uniform() ** 2
    step[:3] *= (0.1 + 0.5 * far) / np.linalg.norm(step[:3])
    step[3:] *= np.radians(3.0 + 17.0 * far) / np.linalg.norm(step[3:])
    # Turned about the camera's centre, and moved in its frame.
    prior = se3.exp(np.concatenate([np.zeros(3), step[3:]])) @ sample.truth
    prior[:3, 3] += step[:3]
    settings = localizer.settings
    aligned = refine_pose(
        localizer,
        localizer.at_the_maps_resolution(to_photo(sample.load(), sample.camera)),
        prior,
        replace(settings.refinement, levels=settings.tracking_levels),
    )
    return of_aligned(aligned, prior) | errors(aligned.cam_from_world, sample)


if __name__ == "__main__":
    sys.exit(main())
