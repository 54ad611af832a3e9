"""Reads reference poses and cameras from a COLMAP model, through pycolmap."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gscpe.errors import CameraError, ColmapModelError, MissingDependencyError
from gscpe.geometry.camera import Camera
from gscpe.interrupts import handlers_kept
from gscpe.scene.references import References


def read_colmap_references(model_folder: str | Path, image_folder: str | Path) -> References:
    """The registered photos of a COLMAP model, sorted by name; all must be in the image folder.

    Raises:
        MissingDependencyError: pycolmap is not installed.
        ColmapModelError: the folder is not a COLMAP model, or photos are missing.
        CameraError: a camera model is not supported.
    """
    try:
        with handlers_kept():
            import pycolmap
    except ImportError as error:
        raise MissingDependencyError(
            "reading a COLMAP model needs pycolmap: pip install pycolmap. Where it has no wheel "
            "(Arm Linux), build the map on another machine and copy the folder"
        ) from error

    model_folder, image_folder = Path(model_folder), Path(image_folder)
    if not model_folder.is_dir():
        raise ColmapModelError(f"{model_folder} is not a folder; give the one with cameras.bin")
    if not any((model_folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt")):
        raise ColmapModelError(f"{model_folder} has no cameras.bin or cameras.txt; is it sparse/0?")
    empty = [path.name for path in model_folder.glob("*.bin") if path.stat().st_size < 8]
    if empty:  # pycolmap would take minutes and all memory to find out
        raise ColmapModelError(f"{model_folder / empty[0]} is damaged: it is empty; copy it again")
    try:
        model = pycolmap.Reconstruction(str(model_folder))
    except Exception as error:  # pycolmap raises plain ValueError, RuntimeError, IndexError, ...
        raise ColmapModelError(
            f"{model_folder} is not a readable COLMAP model: {str(error).strip()}"
        ) from error

    images = [image for image in model.images.values() if image.has_pose]
    images.sort(key=lambda image: image.name)
    if not images:
        raise ColmapModelError(f"{model_folder} holds no photo with a pose")
    missing = [image.name for image in images if not (image_folder / image.name).is_file()]
    if missing:
        raise ColmapModelError(
            f"{len(missing)} of the {len(images)} photos of {model_folder} are not in "
            f"{image_folder}, the first is {missing[0]}; give the folder that the model was made of"
        )
    cameras = {}
    for camera_id, camera in model.cameras.items():
        try:
            cameras[camera_id] = Camera.from_colmap(
                camera.model.name, camera.width, camera.height, list(camera.params)
            )
        except CameraError as error:
            raise CameraError(f"{model_folder}: {error}") from None
    cam_from_world = np.tile(np.eye(4), (len(images), 1, 1))
    for pose, image in zip(cam_from_world, images, strict=True):
        pose[:3] = image.cam_from_world().matrix()
    return References(
        names=tuple(image.name for image in images),
        cam_from_world=cam_from_world,
        cameras=tuple(cameras[image.camera_id] for image in images),
    )
