# SPDX-License-Identifier: Apache-2.0
"""7-Scenes (Microsoft Research), with its own poses or the SfM pseudo ground truth.

Shotton et al., "Scene Coordinate Regression Forests for Camera Relocalization in RGB-D Images",
CVPR 2013; Brachmann, Humenberger, Rother, Sattler, "On the Limits of Pseudo Ground Truth in
Visual Camera Re-Localisation", ICCV 2021.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Literal

from gscpe.arrays import Float64Array
from gscpe.datasets.assembly import make_dataset
from gscpe.datasets.dataset import OFFICIAL, Dataset
from gscpe.datasets.files import missing, parse_numbers, read_lines
from gscpe.datasets.matrix_pose import read_matrix_poses
from gscpe.datasets.photos import image_sizes, list_photos, without_ending
from gscpe.errors import DatasetError, InputError, SettingsError
from gscpe.geometry.camera import Camera
from gscpe.geometry.se3 import from_quaternion_translation

NAME = "7-Scenes"
SCENES = ("chess", "fire", "heads", "office", "pumpkin", "redkitchen", "stairs")
SOURCE = "https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/"
PGT_SOURCE = "https://github.com/tsattler/visloc_pseudo_gt_limitations (folder pgt/sfm/7scenes)"
# The data set has no calibration of its colour camera. 525 is what OpenNI gives for a Kinect and
# what papers use; the SfM pseudo ground truth has its own, from bundle adjustment.
DEFAULT_FOCAL = 525.0

GroundTruth = Literal["sfm", "original"]
_logger = logging.getLogger(__name__)


def read_seven_scenes(
    root: str | Path,
    scene: str,
    ground_truth: GroundTruth = "sfm",
    pgt_folder: str | Path | None = None,
) -> Dataset:
    """A scene of 7-Scenes: ``ROOT/SCENE/TrainSplit.txt``, ``seq-01/frame-000000.color.png``, ...

    Only photos on disk are used: a subset of frames or sequences, or .jpg copies, is enough. Names
    are as on disk, ``seq-01/frame-000000.color.png``.

    Args:
        root: the folder of the scenes.
        scene: one of SCENES.
        ground_truth: "sfm", the pseudo ground truth (world to camera, focal length a photo), or
            "original", the poses of ``frame-*.pose.txt`` (camera to world; of the depth camera's
            SLAM, to which the colour camera was not registered). ``truths`` has both where their
            files are there, the selected first.
        pgt_folder: with ``SCENE_train.txt`` and ``SCENE_test.txt``; None: ROOT/pgt/sfm/7scenes,
            ROOT/SCENE or ROOT.

    Raises:
        DatasetError: a file is missing or has another form.
        SettingsError: there is no such ground truth.
    """
    if ground_truth not in ("sfm", "original"):
        raise SettingsError(f'ground_truth must be "sfm" or "original", not {ground_truth!r}')
    root = Path(root)
    folder = root / scene
    if not folder.is_dir():
        raise DatasetError(
            f"{folder} is missing; the scenes are {', '.join(SCENES)}, and come from {SOURCE}"
        )
    references, all_references = _photos_of_split(folder, "TrainSplit.txt")
    queries, all_queries = _photos_of_split(folder, "TestSplit.txt")
    complete = all_references and all_queries
    photos = [*references, *queries]

    original = read_matrix_poses({photo: _pose_path(folder, photo) for photo in photos}, SOURCE)
    pgt = _find_pgt(root, scene, pgt_folder, needed=ground_truth == "sfm")
    sfm = {} if pgt is None else _read_pgt(pgt, scene)
    cameras = {}
    for photo, (width, height) in image_sizes(folder, photos).items():
        _, focal = sfm.get(without_ending(photo), (None, DEFAULT_FOCAL))
        cameras[photo] = Camera.pinhole(
            width, height, fx=focal, fy=focal, cx=width / 2, cy=height / 2
        )
    both = {
        "sfm": {p: sfm[without_ending(p)][0] for p in photos if without_ending(p) in sfm},
        "original": original,
    }
    other = "original" if ground_truth == "sfm" else "sfm"
    return make_dataset(
        name=NAME,
        scene=scene,
        image_folder=folder,
        cameras=cameras,
        truths={
            name: both[name] for name in (ground_truth, other) if name == ground_truth or both[name]
        },
        queries=queries,
        split=OFFICIAL if complete else f"{OFFICIAL}, incomplete",
    )


def _photos_of_split(folder: Path, split: str) -> tuple[list[str], bool]:
    """Names of the photos on disk of the sequences that a split lists, and whether these are all
    there, without gaps."""
    photos, lost, complete = [], [], True
    for number, line in read_lines(folder / split, SOURCE):
        match = re.fullmatch(r"sequence\s*([0-9]{1,4})", line)
        if match is None:
            raise DatasetError(
                f"{folder / split}, line {number}: expected 'sequence1', got {line[:40]!r}"
            )
        sequence = f"seq-{int(match[1]):02d}"
        found = list_photos(folder / sequence, "frame-*.color.*")
        photos += [f"{sequence}/{photo}" for photo in found]
        frames = {without_ending(photo) for photo in found}
        complete &= frames == {f"frame-{i:06d}.color" for i in range(len(found))} != set()
        if not found:
            lost.append(sequence)
    if not photos:
        first = folder / (lost[0] if lost else split)
        zipped = first.with_suffix(".zip").is_file()
        hint = f"; unpack {first.name}.zip" if zipped else f"; it comes from {SOURCE}"
        raise DatasetError(f"{first} has no photos frame-*.color.png of {split}{hint}")
    if lost:
        _logger.warning("%s: no photos of %s, which %s lists", folder, ", ".join(lost), split)
    return list(dict.fromkeys(photos)), complete


def _pose_path(folder: Path, photo: str) -> Path:
    return folder / (without_ending(photo).removesuffix(".color") + ".pose.txt")


def _find_pgt(
    root: Path, scene: str, pgt_folder: str | Path | None, *, needed: bool
) -> Path | None:
    """The folder with both files of the pseudo ground truth; None: not there, and not needed."""
    if pgt_folder is not None:
        places = [Path(pgt_folder)]
    else:
        places = [root / "pgt" / "sfm" / "7scenes", root / scene, root]
    files = [f"{scene}_train.txt", f"{scene}_test.txt"]
    for place in places:
        if all((place / file).is_file() for file in files):
            return place
    if not needed and pgt_folder is None:
        return None
    # The folder that has one of the two is the one that was meant.
    place = next((p for p in places if any((p / f).is_file() for f in files)), places[0])
    absent = next(file for file in files if not (place / file).is_file())
    raise missing(place / absent, PGT_SOURCE + ', or take ground_truth="original"')


def _read_pgt(folder: Path, scene: str) -> dict[str, tuple[Float64Array, float]]:
    """Photo name without ending -> ``cam_from_world`` and the colour camera's focal length."""
    poses = {}
    for path in (folder / f"{scene}_train.txt", folder / f"{scene}_test.txt"):
        for number, line in read_lines(path, PGT_SOURCE):
            where = f"{path}, line {number}"
            name, *words = line.split()
            values = parse_numbers(words, 8, where, "name qw qx qy qz tx ty tz f")
            try:
                pose = from_quaternion_translation(values[:4], values[4:7])
                # Of any size: it only has to be a focal length.
                Camera.pinhole(1, 1, fx=values[7], fy=values[7], cx=0.5, cy=0.5)
            except InputError as error:
                raise DatasetError(f"{where}: {error}") from None
            poses[without_ending(name)] = pose, values[7]
    return poses
