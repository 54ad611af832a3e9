#!/usr/bin/env python3
"""Shows what separates right poses from wrong ones, on RedKitchen ($GSCPE_DATA).

Localizes the queries, some of them half covered or dark and blurred, and photos of other
places, all without thresholds; and refines queries from priors beside the truth. Prints how
many the thresholds of VerificationSettings let pass, how far each lies from either kind, and
what it would be in the middle (docs/how-it-works.md, Verification).

Usage: .venv/bin/python tools/bench_verification.py MAP --output FILE.jsonl [--reuse]
                        [--matcher NAME] [--every N] [--changed-every N] [--plot FILE.png]

A photo takes one to three seconds on two cores. The evidence is kept in FILE.jsonl; with
--reuse, what is there already is not measured again.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import zlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Iterable, Mapping

import numpy as np
from tqdm import tqdm
from verification_photos import Sample, of_elsewhere, of_redkitchen
from verification_report import plot_roc, print_report, print_tracking

from gscpe import Localizer, LocalizerSettings, PosePrior, open_map
from gscpe.arrays import Float64Array
from gscpe.geometry import pose_difference, se3
from gscpe.localization.attempt import Attempt, Query, Start, to_result
from gscpe.localization.clock import Clock
from gscpe.localization.verification import VerificationSettings, compare_stages, inlier_spread
from gscpe.refinement import RefinementResult, refine_pose
from gscpe.scene import Map, to_photo
from gscpe.scene.poses.hloc import read_poses
from gscpe.scene.query_list import read_query_list

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
TRACKING = "tracking"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("map", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--output", type=Path, required=True, help="evidence, JSON lines")
    parser.add_argument("--reuse", action="store_true", help="keep the evidence that is there")
    parser.add_argument("--matcher", default="auto", metavar="NAME", help="as gscpe localize has")
    parser.add_argument("--every", type=int, default=1, help="only every N-th query")
    parser.add_argument("--changed-every", type=int, default=3, help="... of those to change")
    parser.add_argument("--tracked", type=int, default=40, help="queries to refine from priors")
    parser.add_argument("--hypotheses", type=int, default=1, help="places tried a photo")
    parser.add_argument("--plot", type=Path, help="picture of the ROC curves (extra: plots)")
    options = parser.parse_args()
    data = Path(os.environ.get("GSCPE_DATA", "")) / "redkitchen"
    if not data.is_dir():
        print("set GSCPE_DATA to the folder that holds redkitchen/", file=sys.stderr)
        return 2
    queries = read_query_list(data / "queries.txt")[:: options.every]
    truth = read_poses(data / "truth.txt")
    tracked = queries[:: max(1, len(queries) // options.tracked)][: options.tracked]
    samples = [
        *of_redkitchen(data, queries, truth, options.changed_every),
        *of_elsewhere(data, queries, options.changed_every),
        *(replace(s, kind=TRACKING) for s in of_redkitchen(data, tracked, truth, 0)),
    ]
    known = read_evidence(options.output) if options.reuse else {}
    missing = [sample for sample in samples if (sample.kind, sample.name) not in known]
    if missing:
        if not options.reuse:
            options.output.write_text("")
        measure(open_map(options.map), missing, options)
        known = read_evidence(options.output)
    lines = [known[sample.kind, sample.name] for sample in samples]
    photos = [line for line in lines if line["kind"] != TRACKING]
    print_report(photos, VerificationSettings())
    print_tracking([line for line in lines if line["kind"] == TRACKING], VerificationSettings())
    if options.plot is not None:
        plot_roc(photos, VerificationSettings(), options.plot)
    return 0


def read_evidence(path: Path) -> dict[tuple[str, str], Mapping[str, Any]]:
    """By kind and name of the photo."""
    if not path.is_file():
        return {}
    lines = (json.loads(line) for line in path.read_text().splitlines())
    return {(line["kind"], line["name"]): line for line in lines}


class Recording(Localizer):
    """Keeps every attempt, where a result tells of the best one only."""

    attempts: list[Attempt]

    def _attempt(self, query: Query, start: Start, prior: PosePrior | None) -> Attempt:
        attempt = super()._attempt(query, start, prior)
        self.attempts.append(attempt)
        return attempt


def measure(map_: Map, samples: Iterable[Sample], options: argparse.Namespace) -> None:
    settings = replace(
        LocalizerSettings(), hypotheses=options.hypotheses, verification=NO_THRESHOLDS
    )
    localizer = Recording(map_, settings, options.matcher)
    with localizer, options.output.open("a") as output:
        for sample in tqdm(samples, disable=not sys.stderr.isatty()):
            if sample.kind == TRACKING:
                evidence = [aligned_from_beside(localizer, sample)]
            else:
                localizer.attempts = []
                localizer.localize(sample.load(), sample.camera)
                evidence = [of_attempt(a, sample) for a in localizer.attempts]
            line = {
                "kind": sample.kind,
                "name": sample.name,
                "elsewhere": sample.truth is None,
                "matcher": options.matcher,
                "attempts": evidence,
            }
            output.write(json.dumps(line) + "\n")
            output.flush()


def of_attempt(attempt: Attempt, sample: Sample) -> dict[str, Any]:
    """All that verification looks at; null where a stage gave nothing."""
    coarse, aligned = attempt.coarse, attempt.aligned
    assert coarse is not None
    evidence: dict[str, Any] = {
        "inliers": coarse.inliers,
        "inlier_share": coarse.inliers / max(coarse.matches, 1),
        "spread": inlier_spread(coarse.inlier_pixels, sample.camera),
    }
    final = to_result(attempt, 1, Clock()).cam_from_world
    if aligned is not None and aligned.covariance is not None:
        found = compare_stages(coarse, aligned, VerificationSettings())
        evidence |= of_aligned(aligned, coarse.cam_from_world) | asdict(found)
    at_first = errors(coarse.cam_from_world, sample)
    evidence |= {f"coarse_{name}": value for name, value in at_first.items()}
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
    prior = beside(sample.truth, step)
    settings = localizer.settings
    aligned = refine_pose(
        localizer._renderer,
        to_photo(sample.load(), sample.camera),
        prior,
        replace(settings.refinement, levels=settings.near_levels),
        localizer.map.metres_per_unit,
    )
    return of_aligned(aligned, prior) | errors(aligned.cam_from_world, sample)


def beside(cam_from_world: Float64Array, step: Float64Array) -> Float64Array:
    """Turned about the camera's centre by step[3:], and moved in its frame by step[:3]."""
    turned = se3.exp(np.concatenate([np.zeros(3), step[3:]])) @ cam_from_world
    turned[:3, 3] += step[:3]
    return np.asarray(turned)


if __name__ == "__main__":
    sys.exit(main())
