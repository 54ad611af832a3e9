# SPDX-License-Identifier: Apache-2.0
"""Reference poses and cameras from a COLMAP model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gscpe.errors import ColmapModelError
from gscpe.geometry.camera import Camera
from gscpe.photos.photo_name import name_in_folder
from gscpe.photos.photo_size import SizeMisfit, fit_sizes, photo_size_or_none
from gscpe.scene.colmap_files import read_colmap_files, to_camera
from gscpe.scene.references import References


def read_colmap_references(model_folder: str | Path, image_folder: str | Path) -> References:
    """The registered photos of a COLMAP model, sorted by name; all must be in the image folder.

    Text and binary models are read, with and without points, rigs and frames. Where all photos
    are larger or smaller than the model says by one factor (images_2, images_4), the cameras
    are scaled, with one logged warning. Cameras without a registered photo are ignored.

    Raises:
        ColmapModelError: the folder is not a COLMAP model, photos are missing, or have other
            sizes than the model says.
        CameraError: the model of a camera is not supported.
    """
    model_folder, image_folder = Path(model_folder), Path(image_folder)
    known, images = read_colmap_files(model_folder)
    images.sort(key=lambda image: image.name)
    if not images:
        raise ColmapModelError(f"{model_folder} holds no photo with a pose")
    names = [name_in_folder(image_folder, image.name) for image in images]
    missing = [name for name in names if not (image_folder / name).is_file()]
    if missing:
        raise ColmapModelError(
            f"{len(missing)} of the {len(images)} photos of {model_folder} are not in "
            f"{image_folder}, the first is {missing[0]}; give the folder that the model was "
            "made from"
        )
    by_id: dict[int, Camera] = {}
    for image, name in zip(images, names, strict=True):
        if image.camera_id not in known:
            raise ColmapModelError(f"{model_folder} has no camera of {name}, {image.camera_id}")
        if image.camera_id not in by_id:
            by_id[image.camera_id] = to_camera(known[image.camera_id], f"{model_folder}, {name}")
    cameras = [by_id[image.camera_id] for image in images]
    sizes = [photo_size_or_none(image_folder / name) for name in names]
    fitted = fit_sizes(names, cameras, sizes)
    if isinstance(fitted, SizeMisfit):
        raise ColmapModelError(
            f"photo {image_folder / fitted.name} is {fitted.size[0]}x{fitted.size[1]}, but its "
            f"camera is {fitted.camera.width}x{fitted.camera.height} in the model {model_folder}: "
            f"{fitted}. Give the folder of the photos that the model was made from"
        )
    return References(
        names=tuple(names),
        cam_from_world=np.stack([image.cam_from_world for image in images]),
        cameras=fitted,
    )
