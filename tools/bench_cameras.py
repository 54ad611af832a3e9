#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What wrong cameras do: whether photos are localized all the same, how far off, in degrees and in
their own standard deviations; and for how many the reason says what is wrong with the camera. The
last row is of cameras that the map estimates, from each photo alone.

A camera with "k1" is the right one for the photo, which is bent as if by a lens with that much more
distortion.

Usage: .venv/bin/python tools/bench_cameras.py PLACES.toml [--photos N] [--half odd|even]
           [--wrong KIND ...] [--place NAME ...]

PLACES.toml as for tools/bench_trust.py.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from _common import progress, table
from trust_jobs import HALVES, Place, of_half, read_places, spread

import gscpe
from gscpe.arrays import UInt8Array
from gscpe.errors import CameraError
from gscpe.evaluation import normalized_error_squared
from gscpe.geometry.intrinsics import changed_camera


@dataclass(frozen=True)
class Wrong:
    """A mistake: a change of the camera, see ``Camera.covariance``, and k1 of a lens before it."""

    focal: float = 0.0
    aspect: float = 0.0
    right: float = 0.0
    down: float = 0.0
    k1: float = 0.0

    def camera(self, true: gscpe.Camera) -> gscpe.Camera:
        return changed_camera(true, np.array([self.focal, self.aspect, self.right, self.down, 0.0]))


KINDS: dict[str, Wrong | None] = {
    "right": Wrong(),
    "f x 1.01": Wrong(focal=np.log(1.01)),
    "f x 0.98": Wrong(focal=np.log(0.98)),
    "f x 1.05": Wrong(focal=np.log(1.05)),
    "f x 1.2": Wrong(focal=np.log(1.2)),
    "f x 0.7": Wrong(focal=np.log(0.7)),
    "fy x 1.02": Wrong(focal=0.5 * np.log(1.02), aspect=np.log(1.02)),
    "fy x 1.05": Wrong(focal=0.5 * np.log(1.05), aspect=np.log(1.05)),
    "cx + 2% f": Wrong(right=0.02),
    "cy - 2% f": Wrong(down=-0.02),
    "cy - 5% f": Wrong(down=-0.05),
    "k1 -0.06": Wrong(k1=-0.06),
    "k1 -0.2": Wrong(k1=-0.2),
    "k1 0.1": Wrong(k1=0.1),
    "estimated": None,
}


def bent(image: UInt8Array, camera: gscpe.Camera, k1: float) -> UInt8Array:
    """A photo as a lens with so much more distortion would have taken it."""
    if k1 == 0.0:
        return image
    pinhole = camera.without_distortion()
    size = (camera.width, camera.height)
    grid = np.stack(np.meshgrid(*(np.arange(side, dtype=np.float64) for side in size)), axis=-1)
    matrix, lens = pinhole.opencv_matrix(), np.array([k1, 0.0, 0.0, 0.0])
    seen = cv2.undistortPoints(grid.reshape(-1, 1, 2), matrix, lens, P=matrix)
    u, v = np.moveaxis(seen.reshape(*grid.shape).astype(np.float32), -1, 0)
    bent_image = cv2.remap(image, u, v, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(bent_image, dtype=np.uint8)


def row_of(localizer: gscpe.Localizer, place: Place, name: str, chosen: list[int]) -> list[str]:
    wrong = KINDS[name]
    degrees, sigmas, nees, told = [], [], [], 0
    for index in progress(chosen, f"{place.name}, {name}", len(chosen)):
        query = place.queries[index]
        image, truth = gscpe.read_image(place.images / query.name), place.truth[query.name]
        camera = query.camera
        try:
            if wrong is None:
                camera = localizer.estimate_camera(image)
            else:
                image = bent(image, camera, wrong.k1)
                camera = wrong.camera(camera)
        except CameraError:
            continue
        result = localizer.localize(image, camera)
        told += any(word in (result.reason or "") for word in ("correct intrinsics", "distortion"))
        if result.cam_from_world is None or result.covariance is None:
            continue
        turned = gscpe.pose_difference(result.cam_from_world, truth).degrees
        degrees.append(turned)
        sigma = np.degrees(np.sqrt(np.trace(result.covariance[3:, 3:])))
        sigmas.append(turned / sigma)
        nees.append(normalized_error_squared(result.cam_from_world, result.covariance, truth))
    found = len(degrees)
    return [
        *(place.name, name, f"{found} of {len(chosen)}", f"{told}"),
        f"{np.median(degrees):.2f}" if found else "",
        f"{np.max(sigmas):.1f}" if found else "",
        f"{np.mean(nees):.1f} / {np.median(nees):.1f}" if found else "",
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("places", type=Path, help="TOML file, see tools/bench_trust.py")
    parser.add_argument("--photos", type=int, default=10, help="of each place")
    parser.add_argument("--half", choices=sorted(HALVES), help="this half alone")
    parser.add_argument("--wrong", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--place", nargs="+", help="these places alone")
    options = parser.parse_args()
    rows = []
    for place in read_places(options.places):
        if place.map is None or (options.place and place.name not in options.place):
            continue
        own = [i for i in of_half(place, options.half) if place.queries[i].name in place.truth]
        chosen = [own[i] for i in spread(len(own), options.photos)]
        with gscpe.Localizer(place.map) as localizer:
            rows += [row_of(localizer, place, name, chosen) for name in options.wrong]
    table(
        ["place", "camera", "localized", "the reason is the camera", "median degrees",
         "most sigmas (rotation)", "mean / median NEES"],
        rows,
    )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
