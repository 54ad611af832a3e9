# SPDX-License-Identifier: Apache-2.0
"""Points for a model that has poses but no points: SIFT matches, triangulated by pycolmap."""

from __future__ import annotations

import sqlite3
import tempfile
from pathlib import Path

from gscpe.errors import ColmapModelError, MissingDependencyError
from gscpe.geometry.neighbours import pairs_by_pose
from gscpe.scene.colmap_database import numbered_names, posed_model, pycolmap_camera, set_cameras
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.training.points import PointCloud, cloud_of

_NEIGHBOURS = 12  # photos that each is matched with


def triangulated_points(model_folder: str | Path, image_folder: str | Path) -> PointCloud:
    """Points seen in photos that look at the same places, the poses held as they are.

    It takes about a second a photo of 640x480 on two cores, and most of the points lie on edges
    and texture. The model is not changed.

    Raises:
        MissingDependencyError: pycolmap is not installed.
        ColmapModelError: the model cannot be read, is of other photos, or too few points were
            found.
        CameraError: the model of a camera is not supported.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise MissingDependencyError(
            "triangulating points needs pycolmap: pip install pycolmap"
        ) from error
    references = read_colmap_references(model_folder, image_folder)
    names, poses = list(references.names), references.cam_from_world
    cameras = {
        name: pycolmap_camera(camera)
        for name, camera in zip(names, references.cameras, strict=True)
    }
    logged = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = 2  # pycolmap would tell of each photo
    try:
        with tempfile.TemporaryDirectory(prefix="gscpe-") as name:
            folder = Path(name)
            database = folder / "database.db"
            pairs = folder / "pairs.txt"
            pycolmap.extract_features(
                database, image_folder, names, camera_mode=pycolmap.CameraMode.PER_IMAGE,
                device=pycolmap.Device.cpu,
            )  # fmt: skip
            options = pycolmap.ImportedPairingOptions()
            options.match_list_path = str(pairs)
            with numbered_names(database) as numbers:
                near = pairs_by_pose(poses, range(_NEIGHBOURS))
                pairs.write_text(
                    "".join(f"{numbers[names[a]]} {numbers[names[b]]}\n" for a, b in near)
                )
                pycolmap.match_image_pairs(
                    database, pairing_options=options, device=pycolmap.Device.cpu
                )
            (folder / "model").mkdir()
            set_cameras(database, cameras)
            posed = posed_model(database, dict(zip(names, poses, strict=True)))
            found = pycolmap.triangulate_points(posed, database, image_folder, folder / "model")
    except (RuntimeError, ValueError, sqlite3.Error) as error:
        raise ColmapModelError(
            f"points for {model_folder} could not be triangulated: {str(error).strip()}"
        ) from error
    finally:
        pycolmap.logging.minloglevel = logged
    try:
        return cloud_of(found, {number: image.name for number, image in found.images.items()})
    except ColmapModelError as error:
        raise ColmapModelError(
            f"{model_folder} has no points, and triangulating them failed: {error}. Do the "
            "photos overlap, and do the poses belong to them?"
        ) from None
