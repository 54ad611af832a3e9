#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Follows a camera through a map, frame by frame: each pose begins at the one before.

Usage: python examples/track_sequence.py MAP QUERIES IMAGES [TRUTH]

QUERIES is a list of frames in order (name MODEL width height params...), IMAGES their folder,
TRUTH a pose file (hloc, COLMAP, TUM, JSON) to compare with.
"""

from __future__ import annotations

import sys
import time
from collections import Counter

import numpy as np

import gscpe


def main(map_folder: str, queries: str, images: str, truth: str | None = None) -> None:
    true_poses = gscpe.read_pose_file(truth).poses if truth else {}
    starts: Counter[str] = Counter()
    seconds, errors = [], []
    result = None
    with gscpe.Localizer(map_folder) as localizer:
        for query in gscpe.read_query_list(queries):
            image = gscpe.read_image(f"{images}/{query.name}")
            begin = time.perf_counter()
            result = localizer.localize(image, query.camera, prior=result)
            seconds.append(time.perf_counter() - begin)
            starts[result.started_from or "nothing"] += 1
            if result.cam_from_world is None:
                print(f"{query.name}: not localized: {result.reason}")
            elif query.name in true_poses:
                error = gscpe.pose_difference(result.cam_from_world, true_poses[query.name])
                errors.append((error.distance, error.degrees))
    print(f"{len(seconds)} frames, {1.0 / np.median(seconds):.2f} a second (median)")
    print("started from: " + ", ".join(f"{kind} {count}" for kind, count in starts.items()))
    if errors:
        for which, (distance, degrees) in (
            ("median", np.median(errors, axis=0)),
            ("worst", np.max(errors, axis=0)),
        ):
            metres = localizer.map.metres_per_unit
            length = f"{distance:.4g} map units"
            if metres is not None:
                length = f"{100.0 * metres * distance:.2f} cm"
            print(f"{which} error: {length} / {degrees:.3f} deg")


if __name__ == "__main__":
    if not 4 <= len(sys.argv) <= 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
