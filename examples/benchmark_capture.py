#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures how well one's own capture can be localized in: every eighth photo is a query.

Usage: python examples/benchmark_capture.py SPLAT MODEL_DIR IMAGE_DIR OUTPUT [METRES_PER_UNIT]

SPLAT must be trained without the queries, in the frame of the COLMAP model MODEL_DIR (its
sparse/0) of the photos in IMAGE_DIR. Writes tables, poses and a report to OUTPUT. The unit of a
COLMAP model is nobody's metre unless METRES_PER_UNIT says how long it is.
"""

from __future__ import annotations

import sys
from pathlib import Path

import gscpe


def main(
    splat: str, model_folder: str, image_folder: str, output: str, metres: str | None = None
) -> None:
    metres_per_unit = None if metres is None else float(metres)
    dataset = gscpe.read_colmap(
        model_folder, image_folder, every=8, metres_per_unit=metres_per_unit
    )
    print(f"{len(dataset.references)} references, {len(dataset.queries)} queries")
    settings = gscpe.BenchmarkSettings(resume=True)
    run = gscpe.benchmark_scene(dataset, splat, output, settings, progress=True)
    result = run.evaluate("final")
    print(f"{result.localized} of {result.queries} photos localized")
    if metres_per_unit is None:
        distance = f"{result.median_distance:.4g} map units"
    else:
        distance = f"{100 * result.median_distance:.2f} cm"
    print(f"median {distance} / {result.median_degrees:.3f} deg")
    print(f"look at {Path(output) / 'report.html'}")


if __name__ == "__main__":
    if len(sys.argv) not in (5, 6):
        sys.exit(__doc__)
    main(*sys.argv[1:])
