#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the refinement on the RedKitchen queries of $GSCPE_DATA (docs/benchmarks.md).

Without an option, Lucas-Kanade and Adam, the paper's optimizer, from the same starts. With one:

--basin     how far off a start may be
--ablation  parts of the refinement left out

Usage: .venv/bin/python tools/bench_refinement.py MAP [--queries N] [--iterations N]
           [--basin [--draws N] [--plot FILE.png] | --ablation] [--backend NAME]
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from _common import read_cases, redkitchen
from refinement_compare import compare, measure_basin
from refinement_parts import ablate

from gscpe import Localizer, open_map


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--queries", type=int, default=25, help="so many, evenly spaced")
    parser.add_argument("--backend", default="auto", choices=("auto", "gl", "cpu"))
    parser.add_argument("--draws", type=int, default=50, help="with --basin: starts a distance")
    parser.add_argument("--iterations", type=int, default=20, help="of Adam, a level")
    parser.add_argument("--plot", type=Path, help="with --basin: picture to write (extra: plots)")
    what = parser.add_mutually_exclusive_group()
    for option, meaning in (
        ("basin", "how far off a start may be"),
        ("ablation", "parts of the refinement left out"),
    ):
        what.add_argument(f"--{option}", action="store_true", help=meaning)
    options = parser.parse_args()
    if options.plot and not options.basin:
        parser.error("only --basin draws a picture")
    if min(options.queries, options.draws, options.iterations) < 1:
        parser.error("--queries, --draws and --iterations must be at least 1")
    data = redkitchen()
    with Localizer(open_map(options.map), backend=options.backend) as localizer:
        cases = read_cases(data, options.queries)
        print(f"{len(cases)} queries, {localizer.renderer_description}, {os.cpu_count()} cores\n")
        if options.basin:
            measure_basin(localizer, cases, options.draws, options.plot)
        elif options.ablation:
            ablate(localizer, cases)
        else:
            compare(localizer, cases, options.iterations)
    return 0


if __name__ == "__main__":
    sys.exit(main())
