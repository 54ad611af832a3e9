#!/usr/bin/env python3
"""Measures the refinement on the RedKitchen queries of $GSCPE_DATA (docs/benchmarks.md).

Without an option, Lucas-Kanade and Adam, the paper's optimizer, from the same starts. With one:

--basin         how far off a start may be
--illumination  the whole pipeline on photos that were made darker, noisier, ...
--ablation      parts of the refinement left out

Usage: .venv/bin/python tools/bench_refinement.py MAP [--queries N] [--plot FILE.png]
           [--iterations N] [--draws N] [--basin | --illumination | --ablation]
           [--backend NAME]
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from refinement_ablation import ablate
from refinement_basin import measure_basin
from refinement_cases import read_cases, redkitchen
from refinement_compare import compare
from refinement_illumination import change_light

from gscpe import Localizer, open_map


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--queries", type=int, default=25, help="so many, evenly spaced")
    parser.add_argument("--backend", default="auto", choices=("auto", "gl", "cpu"))
    parser.add_argument("--draws", type=int, default=50, help="with --basin: starts a distance")
    parser.add_argument("--iterations", type=int, default=20, help="of Adam, a level")
    parser.add_argument("--plot", type=Path, help="picture to write (extra: plots)")
    what = parser.add_mutually_exclusive_group()
    for option, meaning in (
        ("basin", "how far off a start may be"),
        ("illumination", "the whole pipeline on changed photos"),
        ("ablation", "parts of the refinement left out"),
    ):
        what.add_argument(f"--{option}", action="store_true", help=meaning)
    options = parser.parse_args()
    if options.plot and (options.illumination or options.ablation):
        parser.error("--illumination and --ablation draw nothing")
    if min(options.queries, options.draws, options.iterations) < 1:
        parser.error("--queries, --draws and --iterations must be at least 1")
    data = redkitchen()
    if data is None:
        print("set GSCPE_DATA to the folder that holds redkitchen/", file=sys.stderr)
        return 2
    with Localizer(open_map(options.map), backend=options.backend) as localizer:
        cases = read_cases(localizer, data, options.queries)
        print(f"{len(cases)} queries, {localizer.renderer_description}, {os.cpu_count()} cores\n")
        if options.basin:
            measure_basin(localizer, cases, options.draws, options.plot)
        elif options.illumination:
            change_light(localizer, cases)
        elif options.ablation:
            ablate(localizer, cases)
        else:
            compare(localizer, cases, options.iterations, options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
