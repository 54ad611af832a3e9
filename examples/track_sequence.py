#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Follows a camera through a map, frame by frame.

Usage: python examples/track_sequence.py MAP QUERIES IMAGES

QUERIES is a list of frames in order (name MODEL width height params...), IMAGES their folder.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np

import gscpe


def main(map_folder: str, queries: str, images: str) -> None:
    settings = gscpe.TrackingSettings(wait=True)  # a file has time; a live camera has not
    results = []
    with gscpe.Tracker(map_folder, settings) as tracker:
        for query in gscpe.read_query_list(queries):
            image = gscpe.read_image(f"{images}/{query.name}")
            result = tracker.track(image, query.camera)
            results.append(result)
            print(f"{query.name}: {result.status}", result.reason or "")
    milliseconds = np.median([result.milliseconds for result in results])
    counts = Counter(result.status for result in results)
    print(f"{len(results)} frames, {milliseconds:.1f} ms each (median)")
    print(", ".join(f"{count} {status}" for status, count in counts.items()))


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
