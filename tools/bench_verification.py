#!/usr/bin/env python3
"""Shows what separates photos of RedKitchen ($GSCPE_DATA) from photos of other places.

Other places: the photographs that ship with scikit-image, and query photos mirrored or upside
down. Prints the ranges of the evidence without thresholds, and how many photos of either kind
are localized with them (docs/how-it-works.md, Verification).

Usage: .venv/bin/python tools/bench_verification.py MAP [--every N]
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Iterator

import cv2
import numpy as np
import skimage.data

from gscpe import Camera, LocalizationResult, Localizer, LocalizerSettings, open_map, read_image
from gscpe.arrays import UInt8Array
from gscpe.scene.query_list import Query, read_query_list
from gscpe.verification import VerificationSettings, inlier_spread

PHOTOGRAPHS = (
    *("astronaut", "brick", "camera", "chelsea", "coffee", "coins", "grass", "gravel"),
    *("hubble_deep_field", "immunohistochemistry", "moon", "page", "retina", "rocket", "text"),
)
NO_THRESHOLDS = VerificationSettings(
    min_inliers=0,
    min_inlier_share=0.0,
    min_spread=0.0,
    min_agreement=-1.0,
    min_overlap=0.0,
    max_shift=np.inf,
    max_shift_degrees=np.inf,
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("map", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--every", type=int, default=3, help="only every N-th query")
    options = parser.parse_args()
    data = Path(os.environ.get("GSCPE_DATA", "")) / "redkitchen"
    if not data.is_dir():
        print("set GSCPE_DATA to the folder that holds redkitchen/", file=sys.stderr)
        return 2
    queries = read_query_list(data / "queries.txt")[:: options.every]
    map_ = open_map(options.map)
    settings = LocalizerSettings()
    without = replace(settings, hypotheses=1, verification=NO_THRESHOLDS)
    for kind in ("RedKitchen", "other places"):
        photos = here(queries, data) if kind == "RedKitchen" else elsewhere(queries, data)
        with Localizer(map_, settings) as strict, Localizer(map_, without) as open_minded:
            results = [
                (strict.localize(image, camera), open_minded.localize(image, camera), camera)
                for image, camera in photos
            ]
        localized = sum(verdict.localized for verdict, _, _ in results)
        print(f"{kind}: {localized} of {len(results)} localized")
        report([(result, camera) for _, result, camera in results])
    return 0


def here(queries: tuple[Query, ...], data: Path) -> Iterator[tuple[UInt8Array, Camera]]:
    for query in queries:
        yield read_image(data / "queries" / query.name), query.camera


def elsewhere(queries: tuple[Query, ...], data: Path) -> Iterator[tuple[UInt8Array, Camera]]:
    camera = queries[0].camera
    for name in PHOTOGRAPHS:
        yield cropped(getattr(skimage.data, name)(), camera), camera
    for image, query_camera in here(queries, data):
        yield np.ascontiguousarray(image[:, ::-1]), query_camera
        yield np.ascontiguousarray(image[::-1]), query_camera


def cropped(image: UInt8Array, camera: Camera) -> UInt8Array:
    """A photograph, grey or colour, filling the camera's image."""
    colour = np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image[:, :, :3]
    scale = max(camera.width / colour.shape[1], camera.height / colour.shape[0])
    size = (int(np.ceil(colour.shape[1] * scale)), int(np.ceil(colour.shape[0] * scale)))
    resized = cv2.resize(np.ascontiguousarray(colour), size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(resized[: camera.height, : camera.width], dtype=np.uint8)


def report(results: list[tuple[LocalizationResult, Camera]]) -> None:
    rows: dict[str, list[float]] = {}
    for result, camera in results:
        coarse, refined = result.coarse, result.refined
        if coarse is not None:
            rows.setdefault("inliers", []).append(coarse.inliers)
            share = coarse.inliers / max(coarse.matches, 1)
            rows.setdefault("inlier share", []).append(share)
            spread = inlier_spread(coarse.inlier_pixels, camera)
            rows.setdefault("spread", []).append(spread)
        if refined is not None and refined.cam_from_world is not None:
            rows.setdefault("correlation", []).append(refined.agreement)
            rows.setdefault("overlap", []).append(refined.overlap)
    for name, values in rows.items():
        low, middle, high = np.nanpercentile(values, [0, 50, 100])
        print(f"  {name:<14} {low:8.2f} to {high:8.2f}, median {middle:8.2f} ({len(values)})")


if __name__ == "__main__":
    sys.exit(main())
