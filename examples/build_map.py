#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Builds a map of a trained splat and its photos, as gscpe build-map does.

Usage: python examples/build_map.py SPLAT MODEL_DIR IMAGE_DIR MAP

MODEL_DIR is the COLMAP model (its sparse/0) that the splat was trained on, IMAGE_DIR its photos,
MAP the folder to write.
"""

from __future__ import annotations

import sys

import gscpe


def main(splat: str, model_folder: str, image_folder: str, map_folder: str) -> None:
    scene = gscpe.read_splat(splat)
    references = gscpe.read_colmap_references(model_folder, image_folder)
    gscpe.check_frames(scene, references, image_folder)  # do splat and photos fit together?
    settings = gscpe.MapSettings(metres_per_unit=1.0)  # None where nobody knows
    map_ = gscpe.build_map(scene, references, image_folder, settings, progress=True)
    gscpe.save_map(map_, map_folder)
    print(map_)


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
