#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What wrong focal lengths do, on RedKitchen ($GSCPE_DATA): whether photos are localized all the
same, how far off, in centimetres and in their own standard deviations; and the focal length that
their matches ask for. The last row is of cameras that the map estimates.

Usage: .venv/bin/python tools/bench_focal.py MAP [--queries N] [--factors 1 1.01 ...]
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
from _common import progress, read_cases, redkitchen, table

import gscpe
from gscpe.evaluation import normalized_error_squared

FACTORS = (1.0, 1.01, 0.98, 1.03, 0.95, 1.1, 0.9, 1.2)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("map", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--queries", type=int, default=12, help="of the 100, evenly spread")
    parser.add_argument("--factors", type=float, nargs="+", default=FACTORS)
    options = parser.parse_args()
    cases = read_cases(redkitchen(), options.queries)
    rows = []
    with gscpe.Localizer(options.map) as localizer:
        for factor in (*options.factors, None):
            centimetres, sigmas, nees, asked = [], [], [], []
            for case in progress(cases, str(factor or "estimated"), len(cases)):
                true = case.query.camera
                if factor is None:
                    camera = localizer.estimate_camera(case.image)
                else:
                    camera = replace(true, fx=factor * true.fx, fy=factor * true.fy)
                result = localizer.localize(case.image, camera)
                if result.coarse is not None and result.coarse.focal is not None:
                    asked.append(abs(np.log(camera.fx * result.coarse.focal.ratio / true.fx)))
                if result.cam_from_world is None or result.covariance is None:
                    continue
                pose = result.cam_from_world
                distance = gscpe.pose_difference(pose, case.truth).distance
                centimetres.append(100.0 * distance)
                sigmas.append(distance / np.sqrt(np.trace(result.covariance[:3, :3])))
                nees.append(normalized_error_squared(pose, result.covariance, case.truth))
            found = len(centimetres)
            rows.append(
                [
                    "estimated" if factor is None else f"{factor:g}",
                    f"{found} of {len(cases)}",
                    f"{np.median(centimetres):.2f}" if found else "",
                    f"{np.max(sigmas):.1f}" if found else "",
                    f"{np.mean(nees):.1f}" if found else "",
                    f"{100.0 * np.median(asked):.2f}%" if asked else "",
                ]
            )
    table(
        ["focal length x", "localized", "median cm", "most sigmas off", "mean NEES",
         "error of the focal length asked for"],
        rows,
    )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
