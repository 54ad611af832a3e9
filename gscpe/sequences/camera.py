# SPDX-License-Identifier: Apache-2.0
"""Cameras of frames: at the size that these have, and from the files of calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping, Sequence

from gscpe.datasets.fast_livo2 import read_vikit_camera
from gscpe.datasets.yaml_file import mapping_with, read_yaml
from gscpe.errors import CameraError, DatasetError
from gscpe.geometry.camera import Camera
from gscpe.photos.photo_size import Size, SizeMisfit, fit_sizes
from gscpe.photos.text_file import read_text_file
from gscpe.scene.colmap_files import MODELS

_EXPECTED = (
    "MODEL width height params..., a COLMAP cameras.txt with one camera, or YAML of ROS's "
    "camera_calibration or of FAST-LIVO2 (camera_pinhole.yaml)"
)


def camera_of_size(camera: Camera, size: Size, what: str) -> Camera:
    """The camera of pictures of this size: scaled, with a warning, where all that differs is the
    scale.

    Raises:
        CameraError: the picture has another shape.
    """
    fitted = fit_sizes([what], [camera], [size])
    if isinstance(fitted, SizeMisfit):
        raise CameraError(
            f"{what} is {size[0]}x{size[1]}, but its camera is {camera.width}x{camera.height}: "
            f"{fitted}. Give the camera of this picture"
        )
    return fitted[0]


def read_camera(text: str) -> Camera:
    """A camera from ``MODEL,width,height,params...``, or from the file of this name.

    Raises:
        CameraError: the text has another form, or the file cannot be read, or has.
        MissingDependencyError: it is YAML, and PyYAML is not installed.
    """
    model = text.replace(",", " ").split()[:1]
    if model and model[0].upper() in {name for name, _ in MODELS}:
        return Camera.typed(text)
    path = Path(text)
    if not path.is_file():
        return Camera.typed(text)  # which says what is wrong
    if path.suffix.lower() in (".yaml", ".yml"):
        return _camera_of_yaml(path)
    try:
        lines = [line.strip() for line in read_text_file(path).splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise CameraError(f"{path} cannot be read as a camera; expected {_EXPECTED}") from error
    lines = [line for line in lines if line and not line.startswith("#")]
    if len(lines) != 1:
        raise CameraError(f"{path} has {len(lines)} cameras, not one; expected {_EXPECTED}")
    words = lines[0].replace(",", " ").split()
    if words[0].isdecimal():  # COLMAP's CAMERA_ID
        words = words[1:]
    try:
        return Camera.typed(" ".join(words))
    except CameraError as error:
        raise CameraError(f"{path}: {error}") from None


def camera_of_calibration(
    size: Size, matrix: Sequence[float], model: str, distortion: Sequence[float], what: str
) -> Camera:
    """The camera of ROS's calibration; OpenCV's pixels become ours (half a pixel more).

    https://docs.ros.org/en/noetic/api/sensor_msgs/html/msg/CameraInfo.html

    Args:
        size: of the picture.
        matrix: K, 9 numbers, row by row.
        model: ``plumb_bob``, ``rational_polynomial``, ``equidistant``, or "" without distortion.
        distortion: D.
        what: the calibration is of, for errors.

    Raises:
        CameraError: the model is not known, or the numbers cannot be a calibration.
    """
    d = [float(value) for value in distortion]
    if len(matrix) != 9:
        raise CameraError(f"{what}: the camera matrix has {len(matrix)} numbers, not 9")
    fx, fy = float(matrix[0]), float(matrix[4])
    if fx <= 0 or fy <= 0:
        raise CameraError(f"{what} is not calibrated (its focal length is {fx:g}): give --camera")
    parameters = [fx, fy, float(matrix[2]) + 0.5, float(matrix[5]) + 0.5]
    if not any(d):
        return Camera.from_colmap("PINHOLE", *size, parameters)
    fisheye = model in ("equidistant", "kannala_brandt", "kannala_brandt4", "fisheye")
    if not fisheye and model not in ("plumb_bob", "rational_polynomial", ""):
        raise CameraError(
            f"{what}: the distortion model {model!r} is not known (plumb_bob, rational_polynomial "
            "and equidistant are): give --camera"
        )
    most = 4 if fisheye else 8
    if any(d[most:]):
        raise CameraError(
            f"{what}: the distortion has {len(d)} coefficients; {model} takes up to {most} here: "
            "give --camera, or rectified images"
        )
    d = (d + [0.0] * most)[:most]
    return Camera.from_colmap("OPENCV_FISHEYE" if fisheye else "FULL_OPENCV", *size, parameters + d)


def _camera_of_yaml(path: Path) -> Camera:
    try:
        values = read_yaml(path, "ROS's camera_calibration, or FAST-LIVO2")
        calibration = mapping_with(values, "camera_matrix")
        if calibration is not None:
            return _of_camera_calibration(calibration, path)
        return read_vikit_camera(path)
    except DatasetError as error:
        raise CameraError(str(error)) from None


def _of_camera_calibration(values: Mapping[str, Any], path: Path) -> Camera:
    """https://wiki.ros.org/camera_calibration_parsers"""
    try:
        size = int(values["image_width"]), int(values["image_height"])
        matrix = [float(number) for number in values["camera_matrix"]["data"]]
        model = str(values.get("distortion_model", values.get("camera_model", "")))
        distortion = [float(n) for n in values["distortion_coefficients"]["data"]]
    except (KeyError, TypeError, ValueError) as error:
        raise CameraError(
            f"{path}: expected image_width, image_height, camera_matrix, distortion_model and "
            f"distortion_coefficients, as ROS's camera_calibration writes them ({error!r})"
        ) from None
    return camera_of_calibration(size, matrix, model, distortion, str(path))
