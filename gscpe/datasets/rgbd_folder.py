# SPDX-License-Identifier: Apache-2.0
"""Plain folders of RGB-D photos with poses: one camera, photos, and poses in one of two forms."""

from __future__ import annotations

from pathlib import Path

from gscpe.arrays import Float64Array
from gscpe.datasets.assembly import make_dataset
from gscpe.datasets.dataset import Dataset
from gscpe.datasets.files import missing, read_lines
from gscpe.datasets.matrix_pose import read_matrix_poses
from gscpe.datasets.photos import list_photos, without_ending
from gscpe.datasets.split import every_nth, every_nth_text
from gscpe.datasets.tum import read_trajectory
from gscpe.errors import CameraError, DatasetError
from gscpe.geometry.camera import Camera
from gscpe.geometry.se3 import inverse

NAME = "RGB-D"
SOURCE = "whoever made the folder (see docs/datasets.md for its layout)"


def read_rgbd_folder(root: str | Path, every: int | None = None) -> Dataset:
    """A folder ``rgb/NAME.png``, ``camera.txt``, and ``poses/NAME.txt`` or ``trajectory.txt``.

    - ``camera.txt``: one line, ``MODEL width height params...``, in COLMAP's words;
    - ``poses/NAME.txt``: a 4x4 camera-to-world matrix, in metres; damaged ones are left out;
    - ``trajectory.txt``, where there is no ``poses``: TUM, camera to world. Photos named by their
      time in seconds, with a point (``1341846313.592026.png``), get interpolated poses; others
      are taken in the order of their names, a line each.

    ``depth`` is not read. Every n-th of the photos with a pose is a query, the first to begin
    with (8 if None).

    Raises:
        DatasetError: a file is missing or has another form.
        SettingsError: ``every`` is below 2.
    """
    root = Path(root)
    image_folder = root / "rgb"
    if not image_folder.is_dir():
        raise missing(image_folder, SOURCE)
    names = list_photos(image_folder)
    if not names:
        raise DatasetError(f"{image_folder} has no photos .png or .jpg")
    poses = _read_poses(root, names)
    return make_dataset(
        name=NAME,
        scene=root.absolute().name,
        image_folder=image_folder,
        cameras=dict.fromkeys(names, _read_camera(root / "camera.txt")),
        truths={"poses": poses},
        queries=every_nth(poses, every),
        split=every_nth_text(every),
    )


def _read_camera(path: Path) -> Camera:
    lines = read_lines(path, SOURCE)
    if len(lines) != 1:
        raise DatasetError(f"{path}: expected one line MODEL width height params, got {len(lines)}")
    text = lines[0][1]
    # A line of COLMAP's cameras.txt begins with a number.
    head, *rest = text.split(maxsplit=1)
    try:
        return Camera.parse(rest[0] if head.isdigit() and rest else text)
    except CameraError as error:
        raise DatasetError(f"{path}: {error}") from None


def _read_poses(root: Path, names: list[str]) -> dict[str, Float64Array]:
    """Photo name -> ``cam_from_world``."""
    folder, path = root / "poses", root / "trajectory.txt"
    if folder.is_dir():
        return read_matrix_poses({n: folder / f"{without_ending(n)}.txt" for n in names}, SOURCE)
    if not path.is_file():
        raise DatasetError(f"{path} is missing, and so is the folder {folder}; give one of them")
    trajectory = read_trajectory(path, SOURCE)
    stems = {name: without_ending(name) for name in names}
    if all("." in stem for stem in stems.values()):
        poses = {}
        for name, stem in stems.items():
            try:
                world_from_cam = trajectory.at(float(stem))
            except ValueError:
                raise DatasetError(f"{root / 'rgb' / name}: the name is not a time") from None
            if world_from_cam is not None:
                poses[name] = inverse(world_from_cam)
        return poses
    if len(trajectory.stamps) != len(names):
        raise DatasetError(
            f"{path} has {len(trajectory.stamps)} poses, but {root / 'rgb'} has {len(names)} "
            "photos that are not named by their time"
        )
    return {
        name: inverse(pose) for name, pose in zip(names, trajectory.world_from_body, strict=True)
    }
