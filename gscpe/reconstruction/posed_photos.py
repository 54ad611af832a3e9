# SPDX-License-Identifier: Apache-2.0
"""Photos whose poses are known, as they are put together: each as its own camera sees it, and not
too large."""

from __future__ import annotations

from pathlib import Path

from tqdm import tqdm

from gscpe.errors import PhotoError
from gscpe.geometry.camera import Camera
from gscpe.photos.image_file import read_image_of
from gscpe.reconstruction.photos import PreparedPhoto, write_photo
from gscpe.reconstruction.sharpness import sharpness
from gscpe.scene.references import References


def prepare_posed_photos(
    references: References,
    image_folder: Path,
    folder: Path,
    max_size: int,
    progress: bool = False,
) -> tuple[list[PreparedPhoto], dict[str, str]]:
    """Writes photos to a folder.

    Args:
        references: names and cameras.
        image_folder: the photos.
        folder: to write to.
        max_size: longer side, pixels; larger ones are shrunk, with their cameras.

    Returns:
        The photos in the order of the references; the text of their camera is COLMAP's, of the size
        that they have now. And why others could not be used, by name.

    Raises:
        CameraError: a photo is of another size than its camera.
        OutputError: they cannot be written.
    """
    photos, unusable = [], {}
    for name, camera in tqdm(
        zip(references.names, references.cameras, strict=True),
        total=len(references),
        desc="reading photos",
        unit="photo",
        disable=not progress,
    ):
        path = image_folder / name
        try:
            image = read_image_of(path, camera)[:, :, :3]
        except PhotoError as error:
            unusable[name] = str(error)
            continue
        written, small = write_photo(image, path, name, folder, max_size)
        height, width = small.shape[:2]
        smaller: Camera = camera.resized(width, height)
        photos.append(
            PreparedPhoto(
                name=written,
                camera=smaller.colmap_text(),
                width=width,
                height=height,
                focal=smaller.fx,
                sharpness=sharpness(small),
            )
        )
    return photos, unusable
