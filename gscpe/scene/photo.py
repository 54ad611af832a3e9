"""Photos: decoding, checking, and removing lens distortion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array, short_repr
from gscpe.errors import CameraError, OutputError, PhotoError
from gscpe.geometry.camera import Camera
from gscpe.scene.image_array import check_image


@dataclass(frozen=True, eq=False)
class Photo:
    """A photo as a pinhole camera took it.

    Attributes:
        rgb: (H, W, 3) uint8.
        camera: pinhole camera of this very size.
        valid: (H, W) bool, false where undistortion had nothing to show; None if all is valid.
    """

    rgb: UInt8Array
    camera: Camera
    valid: BoolArray | None = None

    def __repr__(self) -> str:
        return short_repr(self)


def read_image(path: str | Path) -> UInt8Array:
    """The pixels of an image file as (H, W, 3) uint8 RGB, as stored (EXIF rotation is ignored,
    as in COLMAP, so that they fit the intrinsics). OpenCV's ``imread`` gives BGR instead, which
    gscpe would take for RGB.

    Raises:
        PhotoError: the file is missing or is not an image, or what is given is not a path.
    """
    if not isinstance(path, str | Path):
        raise PhotoError(f"read_image needs the path of an image file, not a {type(path).__name__}")
    path = Path(path)
    try:
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise PhotoError(f"photo {path} cannot be read: {error.strerror}") from error
    bgr = None
    if data.size:
        try:
            bgr = cv2.imdecode(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        except cv2.error:  # some damaged headers raise instead of returning None
            bgr = None
    if bgr is None:
        raise PhotoError(f"{path} is not an image that can be decoded; expected JPEG, PNG, ...")
    return np.ascontiguousarray(bgr[:, :, ::-1])


def to_uint8(image: Float32Array) -> UInt8Array:
    """An image in [0, 1], of any shape, as bytes; values beyond are clipped."""
    return np.asarray(np.rint(np.clip(image, 0.0, 1.0) * 255.0), dtype=np.uint8)


def luminance(rgb: UInt8Array | Float32Array) -> Float32Array:
    """Rec. 601 luminance of (H, W, 3), (H, W) float32; bytes become [0, 1]."""
    scale = 1.0 / 255.0 if rgb.dtype == np.uint8 else 1.0
    weights = np.array([0.299, 0.587, 0.114], dtype=np.float32) * np.float32(scale)
    return np.asarray(rgb.astype(np.float32) @ weights, dtype=np.float32)


def resized_photo(photo: Photo, scale: float) -> Photo:
    """The photo at about ``scale`` times its size, its camera scaled by what it really was."""
    height, width = photo.rgb.shape[:2]
    size = max(1, round(width * scale)), max(1, round(height * scale))
    # Like the undistortion: OpenCV's cubic kernel moves edges by a fraction of a pixel.
    kernel = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LANCZOS4
    rgb = np.asarray(cv2.resize(photo.rgb, size, interpolation=kernel), dtype=np.uint8)
    valid = None
    if photo.valid is not None:
        share = cv2.resize(photo.valid.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        valid = np.asarray(share > 0.99)
    return Photo(rgb, photo.camera.resized(*size), valid)


def shrink(image: Float32Array, width: int, height: int) -> Float32Array:
    """An image, (H, W) or (H, W, 3), at a smaller size; each pixel averages those it covers."""
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def write_image(path: str | Path, rgb: UInt8Array | Float32Array) -> None:
    """Writes (H, W, 3) or (H, W) as uint8, or as float in [0, 1]; the ending names the format.

    Raises:
        OutputError: the file cannot be written.
    """
    path = Path(path)
    pixels = to_uint8(rgb.astype(np.float32)) if rgb.dtype != np.uint8 else rgb.astype(np.uint8)
    if pixels.ndim == 3:
        pixels = np.ascontiguousarray(pixels[:, :, ::-1])
    try:
        encoded, data = cv2.imencode(path.suffix, pixels)
    except cv2.error:  # raised for an ending that no encoder knows
        encoded = False
    if not encoded:
        raise OutputError(f"{path}: cannot encode an image of this kind; use .png or .jpg")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from error


def to_photo(image: UInt8Array, camera: Camera) -> Photo:
    """Checks an image against its camera and removes lens distortion, once.

    The undistorted photo keeps the size, the focal lengths and the principal point.

    Args:
        image: (H, W, 3) uint8 RGB, or (H, W) uint8 grey. OpenCV reads BGR: turn it round,
            ``image[:, :, ::-1]``.
        camera: the camera that took it.

    Raises:
        PhotoError: shape or dtype is wrong.
        CameraError: the camera is of another image size, or is no Camera.
    """
    image = check_image(image)
    if not isinstance(camera, Camera):
        raise CameraError(f"the photo's camera must be a gscpe.Camera, not {camera!r}")
    camera.check_fits(image.shape, "the photo")
    if camera.is_pinhole:
        return Photo(np.ascontiguousarray(image), camera)
    matrix = camera.opencv_matrix()
    size = (camera.width, camera.height)
    map_u, map_v = cv2.initUndistortRectifyMap(
        matrix, np.asarray(camera.distortion), np.eye(3), matrix, size, cv2.CV_32FC1
    )
    # OpenCV's cubic kernel shifts by up to 0.05 px with the phase; this one by up to 0.03.
    undistorted = cv2.remap(
        image, map_u, map_v, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE
    )
    inside_u = (map_u >= 0) & (map_u <= camera.width - 1)
    inside_v = (map_v >= 0) & (map_v <= camera.height - 1)
    valid = inside_u & inside_v
    return Photo(
        np.asarray(undistorted, dtype=np.uint8),
        camera.without_distortion(),
        None if bool(np.all(valid)) else valid,
    )
