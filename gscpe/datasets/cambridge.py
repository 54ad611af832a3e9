# SPDX-License-Identifier: Apache-2.0
"""Cambridge Landmarks: Kendall, Grimes, Cipolla, "PoseNet", ICCV 2015."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Mapping

from gscpe.arrays import Float64Array
from gscpe.datasets.assembly import make_dataset
from gscpe.datasets.dataset import OFFICIAL, Dataset
from gscpe.datasets.files import missing, parse_numbers, read_lines
from gscpe.datasets.nvm import nvm_camera, read_nvm_cameras
from gscpe.datasets.photos import image_sizes, photos_on_disk, without_ending
from gscpe.errors import CameraError, DatasetError, PoseError
from gscpe.geometry.camera import Camera
from gscpe.geometry.se3 import from_quaternion_translation
from gscpe.scene.colmap_model import read_colmap_references

NAME = "Cambridge Landmarks"
SCENES = ("GreatCourt", "KingsCollege", "OldHospital", "ShopFacade", "StMarysChurch", "Street")
SOURCE = "https://www.repository.cam.ac.uk (see http://mi.eng.cam.ac.uk/projects/relocalisation/)"
_COLMAP_MODELS = "CambridgeLandmarks_Colmap_Retriangulated_1024px"
_logger = logging.getLogger(__name__)


def read_cambridge(root: str | Path, scene: str) -> Dataset:
    """A scene of Cambridge Landmarks: ``ROOT/SCENE/dataset_train.txt``, ``seq1/...``, ...

    Poses and split are those of ``dataset_train.txt`` and ``dataset_test.txt``. Photos of these
    that are not on disk are left out. Names are as on disk, ``seq1/frame00001.png``.

    Intrinsics come from ``reconstruction.nvm``: focal length and radial distortion a photo, the
    principal point in the middle. Where there is no such file, they come from a COLMAP model in
    ``sparse/0``, ``sparse``, ``empty_all``, or ``model_train`` and ``model_test``, in the scene's
    folder or in that of the SfM models that hloc uses; then all photos of the model must be on
    disk. Cameras of scaled photos are scaled up.

    Raises:
        DatasetError: a file is missing or has another form.
        ColmapModelError, MissingDependencyError: the COLMAP model cannot be read.
    """
    root = Path(root)
    folder = root / scene
    if not folder.is_dir():
        raise DatasetError(
            f"{folder} is missing; the scenes are {', '.join(SCENES)}, and come from {SOURCE}"
        )
    references = _read_split(folder / "dataset_train.txt")
    queries = _read_split(folder / "dataset_test.txt")
    on_disk = photos_on_disk(folder, [*references, *queries], SOURCE)
    poses = {on_disk[name]: pose for name, pose in references.items() if name in on_disk}
    poses |= {on_disk[name]: pose for name, pose in queries.items() if name in on_disk}
    return make_dataset(
        name=NAME,
        scene=scene,
        image_folder=folder,
        cameras=_cameras(root, scene, image_sizes(folder, poses)),
        truths={"sfm": poses},
        queries=[on_disk[name] for name in queries if name in on_disk],
        split=OFFICIAL if len(poses) == len(references | queries) else f"{OFFICIAL}, incomplete",
    )


def _read_split(path: Path) -> dict[str, Float64Array]:
    """Photo name -> ``cam_from_world`` of lines ``name X Y Z W P Q R``.

    X Y Z is the camera's centre in the world, W P Q R the quaternion, real part first, of the
    rotation from the world to the camera: both are copied from VisualSFM.
    """
    poses = {}
    lines = read_lines(path, SOURCE)
    # Three lines of header, the last one empty, which read_lines left out.
    for number, line in (entry for entry in lines if entry[0] > 3):
        where = f"{path}, line {number}"
        name, *words = line.split()
        values = parse_numbers(words, 7, where, "name X Y Z W P Q R")
        try:
            pose = from_quaternion_translation(values[3:], (0.0, 0.0, 0.0))
        except PoseError as error:
            raise DatasetError(f"{where}: {error}") from None
        if not all(abs(value) < 1e15 for value in values[:3]):
            raise DatasetError(f"{where}: {values[:3]} is not a possible position")
        pose[:3, 3] = -pose[:3, :3] @ values[:3]
        poses[name] = pose
    if not poses:
        raise DatasetError(f"{path} lists no photos; download it again from {SOURCE}")
    return poses


def _cameras(root: Path, scene: str, sizes: Mapping[str, tuple[int, int]]) -> dict[str, Camera]:
    """The camera of each photo, from the first source that there is."""
    nvm = root / scene / "reconstruction.nvm"
    if nvm.is_file():
        return _cameras_of_nvm(nvm, sizes)
    for parent in (root / scene, root / _COLMAP_MODELS / scene):
        for names in (["sparse/0"], ["sparse"], ["empty_all"], ["model_train", "model_test"]):
            models = [parent / name for name in names if _is_model(parent / name)]
            if len(models) == len(names):
                return _cameras_of_models(models, root / scene, sizes)
    raise missing(nvm, f"{SOURCE}; a COLMAP model in {root / scene / 'sparse'} will do, too")


def _cameras_of_nvm(path: Path, sizes: Mapping[str, tuple[int, int]]) -> dict[str, Camera]:
    # The file names .jpg where the data set has .png.
    known = {without_ending(k): v for k, v in read_nvm_cameras(path, SOURCE).items()}
    cameras = {}
    for photo, (width, height) in sizes.items():
        values = known.get(without_ending(photo))
        if values is None:
            raise DatasetError(f"{path} has no camera for {photo}; download it again from {SOURCE}")
        try:
            cameras[photo] = nvm_camera(width, height, *values)
        except CameraError as error:
            raise DatasetError(f"{path}, {photo}: {error}") from None
    return cameras


def _is_model(folder: Path) -> bool:
    return any((folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt"))


def _cameras_of_models(
    models: list[Path], image_folder: Path, sizes: Mapping[str, tuple[int, int]]
) -> dict[str, Camera]:
    known: dict[str, Camera] = {}
    for model in models:
        _logger.info(
            "%s has no reconstruction.nvm; intrinsics are those of %s", image_folder, model
        )
        registered = read_colmap_references(model, image_folder)
        names = (without_ending(name) for name in registered.names)
        known |= zip(names, registered.cameras, strict=True)
    cameras = {}
    for photo, (width, height) in sizes.items():
        camera = known.get(without_ending(photo))
        if camera is None:
            raise DatasetError(f"{models[0]} has no camera for {photo}; give the whole model")
        cameras[photo] = camera.resized(width, height)
    return cameras
