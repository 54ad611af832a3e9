# SPDX-License-Identifier: Apache-2.0
"""Photos as they are put together: upright, not too large, and sorted by the camera that took
them."""

from __future__ import annotations

import hashlib
import logging
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Callable

import cv2
import numpy as np
from tqdm import tqdm

from gscpe.arrays import UInt8Array
from gscpe.errors import OutputError, PhotoError, ReconstructionError
from gscpe.photos.exif import camera_from_exif, exif_of
from gscpe.photos.gps import gps_from_exif
from gscpe.photos.image_file import photo_bytes, read_image
from gscpe.photos.orientation import exif_orientation
from gscpe.reconstruction.disk import when_full
from gscpe.reconstruction.frames import choose_frames, read_frames, watch
from gscpe.reconstruction.settings import ReconstructionSettings
from gscpe.reconstruction.sharpness import sharpness
from gscpe.reconstruction.sources import Source
from gscpe.reconstruction.work_folder import read_kept, write_kept

_log = logging.getLogger(__name__)

_LEAST_PHOTOS = 3
_JPEG_QUALITY = 95
_KEPT_AS_THEY_ARE = {".jpg", ".jpeg"}
_WRITABLE = {".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff"}
_TUPLES = ("gps", "full_size")
_MAKE, _MODEL, _EXIF_BLOCK, _FOCAL = 0x010F, 0x0110, 0x8769, 0x920A


@dataclass(frozen=True)
class PreparedPhoto:
    """A photo in the work folder.

    Attributes:
        name: relative to the folder of photos.
        camera: photos with the same text were taken by one camera, zoomed alike.
        width, height: pixels.
        focal: focal length, pixels; None where the photo does not say.
        sharpness: see :func:`sharpness`.
        video: the video that it is of; "" for none.
        gps: latitude, longitude, altitude; None where it does not say.
        full_size: width and height of the photo that it was made of, upright; None for a frame.
    """

    name: str
    camera: str
    width: int
    height: int
    focal: float | None
    sharpness: float
    video: str = ""
    gps: tuple[float, float, float] | None = None
    full_size: tuple[int, int] | None = None


def prepare_photos(
    source: Source, folder: Path, settings: ReconstructionSettings, progress: bool = False
) -> tuple[list[PreparedPhoto], dict[str, str]]:
    """Writes the photos and the videos' frames to a folder.

    Returns:
        The photos, sorted by name; and why others could not be used, by name.

    Raises:
        ReconstructionError: fewer than 3 are left, or all are blurred; the only video cannot be
            decoded or hardly moves.
        OutputError: they cannot be written.
    """
    unusable: dict[str, str] = {}
    photos = []
    seen: dict[bytes, str] = {}
    for name, path in tqdm(
        sorted(source.photos.items(), key=lambda item: (len(item[0]), item[0])),  # copies are last
        desc="reading photos",
        unit="photo",
        disable=not progress,
    ):
        try:
            _check_name(name)
            same = seen.setdefault(hashlib.sha256(photo_bytes(path)).digest(), name)
            if same != name:
                raise PhotoError(f"is a copy of {same}")
            photos.append(_prepare_photo(name, path, folder, settings.max_size))
        except PhotoError as error:
            unusable[name] = str(error)
    frames = max(3, settings.frames // max(len(source.videos), 1))
    for name, path in source.videos.items():
        try:
            photos += _prepare_video(name, path, folder, frames, settings.max_size, progress)
        except ReconstructionError as error:
            if not source.photos and len(source.videos) == 1:
                raise
            unusable[name] = str(error)
    photos.sort(key=lambda photo: photo.name)
    if len(photos) < _LEAST_PHOTOS:
        why = f" ({next(iter(unusable.values()))})" if unusable else ""
        raise ReconstructionError(
            f"{len(photos)} usable photos are too few{why}: at least {_LEAST_PHOTOS} from "
            "different places are needed, and 30 to 200 make a good map"
        )
    if all(photo.sharpness < settings.min_sharpness for photo in photos):
        best = max(photo.sharpness for photo in photos)
        raise ReconstructionError(
            f"all {len(photos)} photos are blurred (the sharpest has {best:.2f}, where "
            f"{settings.min_sharpness:g} is needed and 0.6 is usual): hold the camera still, give "
            "it more light, and clean the lens"
        )
    return photos, unusable


def _check_name(name: str) -> None:
    """Raises PhotoError for bytes that pycolmap's databases cannot hold."""
    try:
        name.encode()
    except UnicodeEncodeError:
        raise PhotoError("has a name that is not UTF-8; rename it") from None


Prepared = tuple[list[PreparedPhoto], dict[str, str]]
"""The photos, and why others cannot be used, by name."""


def prepared_once(listed: Path, prepare: Callable[[], Prepared]) -> Prepared:
    """What ``prepare`` gives. It is kept in the file ``listed``, for a run that goes on."""
    if listed.exists():
        stored = read_kept(listed)
        photos = [
            PreparedPhoto(
                **{**entry, **{key: entry.get(key) and tuple(entry[key]) for key in _TUPLES}}
            )
            for entry in stored["photos"]
        ]
        return photos, dict(stored["unusable"])
    photos, unusable = prepare()
    write_kept(listed, {"photos": [asdict(photo) for photo in photos], "unusable": unusable})
    return photos, unusable


def write_photo(
    image: UInt8Array, path: Path, name: str, folder: Path, max_size: int
) -> tuple[str, UInt8Array]:
    """Writes a photo for others to read who know neither HEIC nor EXIF.

    Args:
        image: (H, W, 3), turned as it is to be.
        path: where it was read from; a JPEG that needs no change is copied.
        name: to write, in ``folder``.
        max_size: longer side, pixels.

    Returns:
        The name, with another ending where it must be, and the photo as it was written.

    Raises:
        OutputError: it cannot be written.
    """
    small = _shrunk(image, max_size)
    ending = path.suffix.lower()
    if ending not in _WRITABLE:
        name = f"{name}.jpg"
    stored = path.read_bytes()
    # By its bytes, too: phones call HEIC photos .jpg.
    is_jpeg = ending in _KEPT_AS_THEY_ARE and stored[:2] == b"\xff\xd8"
    as_it_is = small is image and is_jpeg and exif_orientation(path) == 1
    _write(folder / name, stored if as_it_is else _encoded(small, name))
    return name, small


def _prepare_photo(name: str, path: Path, folder: Path, max_size: int) -> PreparedPhoto:
    image = read_image(path, upright=True)[:, :, :3]
    height, width = image.shape[:2]
    name, small = write_photo(image, path, name, folder, max_size)
    guess = camera_from_exif(path, upright=True)
    focal = None if guess is None else guess.fx * small.shape[1] / width
    exif = exif_of(path)
    maker = " ".join(str(exif.get(tag, "")).strip("\0 ") for tag in (_MAKE, _MODEL))
    zoom = exif.get_ifd(_EXIF_BLOCK).get(_FOCAL, "")
    return PreparedPhoto(
        name=name,
        camera=f"{maker} {zoom} {width}x{height}".strip(),
        width=small.shape[1],
        height=small.shape[0],
        focal=focal,
        sharpness=sharpness(small),
        gps=gps_from_exif(path),
        full_size=(width, height),
    )


def _prepare_video(
    name: str, path: Path, folder: Path, count: int, max_size: int, progress: bool
) -> list[PreparedPhoto]:
    chosen = choose_frames(watch(path, progress), count)
    _log.info("%s: %d frames are taken", path, len(chosen))
    numbers = [frame.number for frame in chosen]
    photos = []
    frames = tqdm(
        read_frames(path, numbers),
        desc=f"taking frames of {path.name}",
        total=len(numbers),
        disable=not progress,
    )
    for number, image in frames:
        small = _shrunk(image, max_size)
        height, width = small.shape[:2]
        frame_name = f"{name}/{number:06d}.jpg"
        _write(folder / frame_name, _encoded(small, frame_name))
        photos.append(
            PreparedPhoto(frame_name, name, width, height, None, sharpness(small), video=name)
        )
    return photos


def _shrunk(image: UInt8Array, max_size: int) -> UInt8Array:
    height, width = image.shape[:2]
    scale = max_size / max(height, width)
    if scale >= 1.0:
        return image
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _encoded(image: UInt8Array, name: str) -> bytes:
    ending = Path(name).suffix.lower()
    quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if ending in _KEPT_AS_THEY_ARE else []
    done, data = cv2.imencode(ending, np.ascontiguousarray(image[:, :, ::-1]), quality)
    if not done:
        raise OutputError(f"this OpenCV cannot write {ending} images")
    return data.tobytes()


def _write(path: Path, data: bytes) -> None:
    with when_full(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
