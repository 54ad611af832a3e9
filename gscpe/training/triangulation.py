# SPDX-License-Identifier: Apache-2.0
"""Points for a model that has poses but no points: SIFT matches, triangulated by pycolmap."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import ColmapModelError, MissingDependencyError
from gscpe.training.points import PointCloud, cloud_of

_NEIGHBOURS = 12  # photos that each is matched with
_RIGHT_ANGLE = 0.5 * np.pi


def triangulated_points(model_folder: str | Path, image_folder: str | Path) -> PointCloud:
    """Points seen in photos that look at the same places, the poses held as they are.

    It takes about a second a photo of 640x480 on two cores, and most of the points lie on edges
    and texture. The model is not changed.

    Raises:
        MissingDependencyError: pycolmap is not installed.
        ColmapModelError: the model cannot be read, or too few points were found.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise MissingDependencyError(
            "triangulating points needs pycolmap: pip install pycolmap"
        ) from error
    model = pycolmap.Reconstruction(str(model_folder))
    images = sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)
    names = [image.name for image in images]
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    for pose, image in zip(poses, images, strict=True):
        pose[:3] = image.cam_from_world().matrix()
    logged = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = 2  # pycolmap would tell of each photo
    try:
        with tempfile.TemporaryDirectory(prefix="gscpe-") as name:
            folder = Path(name)
            database = folder / "database.db"
            pairs = folder / "pairs.txt"
            pairs.write_text(
                "".join(f"{names[a]} {names[b]}\n" for a, b in pairs_that_look_alike(poses))
            )
            pycolmap.extract_features(
                database, image_folder, names, camera_mode=pycolmap.CameraMode.PER_IMAGE,
                device=pycolmap.Device.cpu,
            )  # fmt: skip
            options = pycolmap.ImportedPairingOptions()
            options.match_list_path = str(pairs)
            pycolmap.match_image_pairs(
                database, pairing_options=options, device=pycolmap.Device.cpu
            )
            (folder / "model").mkdir()
            posed = _posed(database, model)
            found = pycolmap.triangulate_points(posed, database, image_folder, folder / "model")
    except (RuntimeError, ValueError) as error:
        raise ColmapModelError(
            f"points for {model_folder} could not be triangulated: {str(error).strip()}"
        ) from error
    finally:
        pycolmap.logging.minloglevel = logged
    try:
        return cloud_of(found)
    except ColmapModelError as error:
        raise ColmapModelError(
            f"{model_folder} has no points, and triangulating them failed: {error}. Do the "
            "photos overlap, and do the poses belong to them?"
        ) from None


def _posed(database: Path, model: Any) -> Any:
    """The photos of a database with the poses and cameras that a model gives them, by name; the
    numbers of everything are the database's."""
    import pycolmap

    by_name = {image.name: image for image in model.images.values() if image.has_pose}
    posed = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as stored:
        images = stored.read_all_images()
        for image in images:
            camera = pycolmap.Camera(model.cameras[by_name[image.name].camera_id].todict())
            camera.camera_id = image.camera_id
            stored.update_camera(camera)  # which was a guess
            posed.add_camera(camera)
        for rig in stored.read_all_rigs():
            posed.add_rig(rig)
        pose_of_frame = {i.frame_id: by_name[i.name].cam_from_world() for i in images}
        for frame in stored.read_all_frames():
            frame.rig_from_world = pose_of_frame[frame.frame_id]
            posed.add_frame(frame)
        for image in images:
            posed.add_image(image)
            posed.register_frame(image.frame_id)
    return posed


def pairs_that_look_alike(cam_from_world: Float64Array) -> list[tuple[int, int]]:
    """Pairs of photos, first below second, that may see the same: each with those nearest to it
    by distance of the centres (in units of the cameras' median spread) and angle between the
    viewing axes (in right angles), of those less than a right angle apart."""
    centres = -np.einsum("nji,nj->ni", cam_from_world[:, :3, :3], cam_from_world[:, :3, 3])
    spread = np.median(np.linalg.norm(centres - np.median(centres, axis=0), axis=1))
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) / max(float(spread), 1e-12)
    axes = cam_from_world[:, 2, :3]
    angles = np.arccos(np.clip(axes @ axes.T, -1.0, 1.0)) / _RIGHT_ANGLE
    cost = np.where(angles < 1.0, apart + angles, np.inf)
    np.fill_diagonal(cost, np.inf)
    pairs = set()
    for first, row in enumerate(cost):
        for second in np.argsort(row, kind="stable")[:_NEIGHBOURS]:
            if np.isfinite(row[second]):
                pairs.add((min(first, int(second)), max(first, int(second))))
    return sorted(pairs)
