# SPDX-License-Identifier: Apache-2.0
"""Cameras of VisualSFM's NVM_V3 files, and its lens distortion as COLMAP's FULL_OPENCV.

A line a camera: ``file focal qw qx qy qz cx cy cz radial 0``; http://ccwu.me/vsfm/doc.html#nvm.

VisualSFM (bundle adjustment PBA, "measurement distortion") corrects what was measured: with
``m`` the distorted pixel relative to the image centre, divided by the focal length, the ideal
point is ``(1 + radial * |m|^2) * m``. COLMAP and OpenCV go the other way, from the ideal point
to the distorted. No polynomial is the exact inverse, so one is fitted.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gscpe.datasets.files import parse_numbers, reading
from gscpe.errors import CameraError, DatasetError
from gscpe.geometry.camera import Camera

_FORM = "file focal qw qx qy qz cx cy cz radial 0"
_FIT_TOLERANCE_PIXELS = 0.02


def read_nvm_cameras(path: Path, source: str) -> dict[str, tuple[float, float]]:
    """File name -> focal length in pixels and radial distortion, of the first model.

    Raises:
        DatasetError: the file is missing, not of NVM_V3, or damaged.
    """
    with reading(path, source), path.open(encoding="utf-8-sig") as file:
        # The 3D points, which fill most of the file, are not read.
        lines = ((i, line.split()) for i, line in enumerate(file, 1) if line.strip())
        _, header = next(lines, (0, [""]))
        if header[0] != "NVM_V3":
            raise DatasetError(f"{path} is not a VisualSFM file: it does not begin with NVM_V3")
        number, count = next(lines, (0, []))
        (total,) = parse_numbers(count, 1, f"{path}, line {number}", "number of cameras")
        cameras: dict[str, tuple[float, float]] = {}
        for number, words in lines:
            if len(cameras) >= total:
                break
            values = parse_numbers(words[1:], 10, f"{path}, line {number}", _FORM)
            cameras[words[0]] = values[0], values[8]
    if len(cameras) != total:
        raise DatasetError(f"{path} is truncated: {len(cameras)} of {total:.0f} cameras")
    return cameras


def nvm_camera(width: int, height: int, focal: float, radial: float) -> Camera:
    """The camera of an NVM file, its principal point the image centre.

    The forward model is OpenCV's rational one, fitted by least squares over the radii of the
    image; it is at most 0.02 px off anywhere.

    Args:
        width, height: of the photo, in pixels.
        focal: in pixels.
        radial: VisualSFM's distortion, see above.

    Raises:
        CameraError: the focal length is no focal length, or the distortion folds the image or
            is too strong for the model.
    """
    camera = Camera.pinhole(width, height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)
    if radial == 0.0:
        return camera
    corner = float(np.hypot(width, height)) / (2.0 * focal)
    if not 1.0 + 3.0 * radial * corner**2 > 0.0 or not abs(radial) * corner**2 < 1e3:
        raise CameraError(f"the radial distortion {radial} folds an image with focal {focal}")
    distorted = np.linspace(0.0, corner, 400)[1:]
    ideal = distorted * (1.0 + radial * distorted**2)
    # distorted * (1 + k4 r^2 + k5 r^4 + k6 r^6) = ideal * (1 + k1 r^2 + k2 r^4 + k3 r^6) with
    # r the ideal radius: linear in k. Radii are scaled to [0, 1], which keeps it well posed.
    scale = float(ideal.max())
    powers = (ideal / scale)[:, None] ** (2, 4, 6)
    system = np.hstack([ideal[:, None] * powers, -distorted[:, None] * powers])
    k, *_ = np.linalg.lstsq(system, distorted - ideal, rcond=None)
    fitted = ideal * (1.0 + powers @ k[:3]) / (1.0 + powers @ k[3:])
    if not float(np.abs(fitted - distorted).max()) * focal < _FIT_TOLERANCE_PIXELS:
        raise CameraError(f"the radial distortion {radial} is too strong to be converted")
    k1, k2, k3, k4, k5, k6 = (float(x) for x in k / scale ** np.array([2, 4, 6, 2, 4, 6]))
    parameters = [focal, focal, width / 2, height / 2, k1, k2, 0.0, 0.0, k3, k4, k5, k6]
    return Camera.from_colmap("FULL_OPENCV", width, height, parameters)
