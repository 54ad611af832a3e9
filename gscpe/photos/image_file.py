# SPDX-License-Identifier: Apache-2.0
"""Image files as 8-bit RGB, whatever they hold: more bits, floats, transparency, HEIC."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array, UInt8Array
from gscpe.errors import CameraError, OutputError, PhotoError
from gscpe.geometry.camera import Camera
from gscpe.output_file import write_file
from gscpe.photos.orientation import exif_orientation, swaps_sides, turned_image

_JPEG, _JPEG_END, _RADIANCE = b"\xff\xd8", b"\xff\xd9", (b"#?RADIANCE", b"#?RGBE")
_HEIC_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs"}
_BIT_DEPTHS = (8, 10, 12, 14, 16)  # of cameras that store raw values in 16 bits


def read_image(path: str | Path, *, upright: bool = False) -> UInt8Array:
    """The pixels of an image file, (H, W, 3) uint8 RGB; (H, W, 4) where some are transparent.

    Values of 10, 12 or 14 bits in 16 are stretched to the full range; floats are taken to be in
    [0, 1], or in [0, 255] where they reach beyond, and NaN as transparent. HEIC is read through
    pillow-heif, as it is displayed.

    Args:
        path: of the file.
        upright: turn it as its EXIF orientation says. Else, the pixels are as they are stored, as
            in COLMAP, so that they fit the intrinsics.

    Raises:
        PhotoError: the file is missing, is not an image, or holds values of an unknown range; or
            it is HEIC, and pillow-heif is not installed; or what is given is not a path.
    """
    if not isinstance(path, str | Path):
        raise PhotoError(f"read_image needs the path of an image file, not a {type(path).__name__}")
    return decode_image(photo_bytes(path), path, upright)


def photo_bytes(path: str | Path) -> bytes:
    """The bytes of a photo's file.

    Raises:
        PhotoError: it is missing, or cannot be read.
    """
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise PhotoError(f"photo {path} cannot be read: {error.strerror}") from error


def decode_image(data: bytes, name: str | Path, upright: bool = False) -> UInt8Array:
    """As :func:`read_image`, of the bytes of a file; ``name`` is what messages call it."""
    stored = _heic(data, name) if is_heic(data) else _decoded(data)
    if stored is None or stored.size == 0:
        raise PhotoError(f"{name} {_why_not_decoded(data)}")
    image = _rgb_or_rgba(stored, data, name)
    return turned_image(image, exif_orientation(data)) if upright else image


def _why_not_decoded(data: bytes) -> str:
    if not data:
        return "is empty"
    if data.startswith(_JPEG) and _JPEG_END not in data[-1024:]:
        return "is a JPEG that is cut off: its end is missing"
    return "is not an image that can be decoded; expected JPEG, PNG, ..."


def read_image_of(path: str | Path, camera: Camera) -> UInt8Array:
    """The pixels that a camera took, as :func:`read_image`: as they are stored where it has their
    size; turned upright as EXIF says where it has that of the photo as it is shown.

    Raises:
        PhotoError: as :func:`read_image`.
        CameraError: the camera has neither size. The message names the photo.
    """
    if not isinstance(path, str | Path):
        raise PhotoError(f"a photo is read from its path, not from a {type(path).__name__}")
    return decode_image_of(photo_bytes(path), path, camera)


def decode_image_of(data: bytes, name: str | Path, camera: Camera) -> UInt8Array:
    """As :func:`read_image_of`, of the bytes of a file; ``name`` is what messages call it."""
    image = decode_image(data, name)
    height, width = image.shape[:2]
    if (width, height) == (camera.width, camera.height):
        return image
    orientation = exif_orientation(data)
    turned = (width, height) == (camera.height, camera.width)
    if turned and swaps_sides(orientation):
        return turned_image(image, orientation)
    if turned:
        raise CameraError(
            f"{name} is {width}x{height}, but its camera is {camera.width}x{camera.height}, "
            "which fits the photo turned by 90 degrees (its EXIF data does not say that it is "
            "turned): give the camera of the stored pixels, or turn the photo"
        )
    camera.check_fits(image.shape, str(name))
    return image


def is_heic(data: bytes) -> bool:
    """Whether a file's first bytes are those of a HEIC photo."""
    length = int.from_bytes(data[:4], "big")
    if data[4:8] != b"ftyp" or length > 1024:
        return False
    brands = {data[i : i + 4] for i in (8, *range(16, min(length, len(data)), 4))}
    return bool(brands & _HEIC_BRANDS)


def heic_photo(data: bytes, name: str | Path) -> Any:
    """pillow-heif's image.

    Raises:
        PhotoError: it is damaged, or pillow-heif is not installed.
    """
    try:
        import pillow_heif
    except ImportError as error:
        raise PhotoError(
            f"{name} is HEIC, which needs pillow-heif: pip install 'gscpe[heic]'; or convert it "
            "to JPEG"
        ) from error
    try:
        return pillow_heif.open_heif(data)
    except Exception as error:  # ValueError, EOFError, SyntaxError, RuntimeError, ...
        raise PhotoError(f"{name} is a damaged HEIC photo ({error}); copy it again") from error


def _heic(data: bytes, name: str | Path) -> NDArray[Any]:
    photo = heic_photo(data, name)
    try:
        rgb = np.asarray(photo)
    except Exception as error:  # decoding happens here
        raise PhotoError(f"{name} is a damaged HEIC photo ({error}); copy it again") from error
    if rgb.ndim == 3:  # as OpenCV has it
        rgb = rgb[:, :, [2, 1, 0, *range(3, rgb.shape[2])]]
    return rgb


def _decoded(data: bytes) -> NDArray[Any] | None:
    """As OpenCV has it: blue first, any type, 1 to 4 channels; None where it cannot."""
    if not data:
        return None
    # A JPEG may be CMYK, which only this converts; it has 8 bits and nothing transparent.
    as_colour = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    flags = as_colour if data[:2] == _JPEG else cv2.IMREAD_UNCHANGED
    try:
        return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:  # some damaged headers raise instead of returning None
        return None


def _rgb_or_rgba(stored: NDArray[Any], data: bytes, name: str | Path) -> UInt8Array:
    if stored.ndim == 2:
        stored = stored[:, :, None]
    colours, alpha = stored, None
    if stored.shape[2] in (2, 4):
        colours, alpha = stored[:, :, :-1], _opaque(stored[:, :, -1])
    known = np.isfinite(colours).all(axis=2) if colours.dtype.kind == "f" else None
    if known is not None and not known.all():
        alpha = known if alpha is None else alpha & known
        colours = np.where(np.isfinite(colours), colours, 0)
    if colours.shape[2] == 1:
        colours = np.repeat(colours, 3, axis=2)
    rgb = _eight_bits(colours, data, name)[:, :, ::-1]
    if alpha is None or alpha.all():
        return np.ascontiguousarray(rgb)
    if not alpha.any():
        raise PhotoError(f"{name} is completely transparent: there is nothing to see")
    return np.dstack([rgb, np.where(alpha, np.uint8(255), np.uint8(0))])


def _opaque(alpha: NDArray[Any]) -> NDArray[np.bool_]:
    full = 1.0 if alpha.dtype.kind == "f" else float(np.iinfo(alpha.dtype).max)
    return np.asarray(alpha >= 0.5 * full)


def _eight_bits(values: NDArray[Any], data: bytes, name: str | Path) -> UInt8Array:
    if values.dtype == np.uint8:
        return np.asarray(values)
    largest = float(values.max())
    if values.dtype.kind == "f":
        if data.startswith(_RADIANCE) or largest <= 1.0:
            return to_uint8(np.asarray(values, dtype=np.float32))
        if largest <= 255.0:
            return to_uint8(np.asarray(values / 255.0, dtype=np.float32))
    bits = next((bits for bits in _BIT_DEPTHS if largest < 2**bits), None)
    if bits is None:
        raise PhotoError(
            f"{name} holds {values.dtype} values up to {largest:.4g}; save it as 8-bit PNG"
        )
    return np.asarray(np.clip(values, 0, None).astype(np.uint16) >> (bits - 8), dtype=np.uint8)


def to_uint8(image: Float32Array) -> UInt8Array:
    """An image in [0, 1], of any shape, as bytes; values beyond are clipped."""
    return np.asarray(np.rint(np.clip(image, 0.0, 1.0) * 255.0), dtype=np.uint8)


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
    write_file(path, data.tobytes())
