# SPDX-License-Identifier: Apache-2.0
"""Known cameras, poses and names put into what pycolmap has found of photos."""

from __future__ import annotations

import sqlite3
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Iterable, Iterator, Mapping

from gscpe.arrays import Float64Array
from gscpe.geometry.camera import Camera

_NAMES = "gscpe_names"


@contextmanager
def numbered_names(database: Path) -> Iterator[dict[str, int]]:
    """Photos are called by their numbers meanwhile: pycolmap's lists of pairs cannot hold names
    with blanks.

    Who is killed here leaves the numbers; :func:`restore_names` brings the names back.

    Args:
        database: file of COLMAP, which nobody has opened now.

    Yields:
        The photos' numbers, by name.
    """
    restore_names(database)
    with _changing(database) as change:
        names = dict(change.execute("SELECT name, image_id FROM images"))
        change.execute(f"CREATE TABLE {_NAMES} AS SELECT image_id, name FROM images")
        change.execute("UPDATE images SET name = CAST(image_id AS TEXT)")
    try:
        yield names
    finally:
        restore_names(database)


def restore_names(database: Path) -> None:
    """Undoes :func:`numbered_names`; nothing, where there is nothing to undo."""
    if not database.exists():
        return
    with _changing(database) as change:
        of_ours = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
        if change.execute(of_ours, (_NAMES,)).fetchone():
            stored = f"SELECT name FROM {_NAMES} WHERE {_NAMES}.image_id = images.image_id"
            change.execute(f"UPDATE images SET name = ({stored})")
            change.execute(f"DROP TABLE {_NAMES}")


@contextmanager
def _changing(database: Path) -> Iterator[sqlite3.Connection]:
    """All that is changed meanwhile, or nothing."""
    with closing(sqlite3.connect(database, isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        yield connection
        connection.execute("COMMIT")


def set_cameras(database: Path, cameras: Mapping[str, Any]) -> None:
    """Replaces the guessed cameras of a COLMAP database.

    Args:
        database: file; photos in it that share a camera must do so in ``cameras``.
        cameras: pycolmap.Camera by name of the photo, whatever their numbers.
    """
    import pycolmap

    with pycolmap.Database.open(database) as stored:
        by_number = {image.camera_id: image.name for image in stored.read_all_images()}
        for number, name in by_number.items():
            camera = pycolmap.Camera(cameras[name].todict())
            camera.camera_id = number
            camera.has_prior_focal_length = True
            stored.update_camera(camera)


def pycolmap_camera(camera: Camera) -> Any:
    """The pycolmap.Camera."""
    import pycolmap

    model, width, height, *parameters = camera.colmap_text().split()
    return pycolmap.Camera(
        model=model,
        width=int(width),
        height=int(height),
        params=[float(parameter) for parameter in parameters],
    )


def posed_model(database: Path, poses: Mapping[str, Float64Array]) -> Any:
    """A pycolmap.Reconstruction without points of a database's photos, with its cameras and
    numbers.

    Args:
        database: file.
        poses: ``cam_from_world``, (4, 4), by name. Other photos are not in the model.
    """
    import pycolmap

    with pycolmap.Database.open(database) as stored:
        return pose_model(
            stored.read_all_cameras(),
            stored.read_all_rigs(),
            stored.read_all_frames(),
            stored.read_all_images(),
            poses,
        )


def pose_model(
    cameras: Iterable[Any],
    rigs: Iterable[Any],
    frames: Iterable[Any],
    images: Iterable[Any],
    poses: Mapping[str, Float64Array],
) -> Any:
    """The same of pycolmap's cameras, rigs, frames and images, one camera a rig."""
    import pycolmap

    posed = pycolmap.Reconstruction()
    images = [image for image in images if image.name in poses]
    pose_of_frame = {image.frame_id: poses[image.name] for image in images}
    used = {image.camera_id for image in images}
    for camera in cameras:
        if camera.camera_id in used:
            posed.add_camera(camera)
    for rig in rigs:
        if rig.ref_sensor_id.id in used:
            posed.add_rig(rig)
    for frame in frames:
        if frame.frame_id in pose_of_frame:
            frame.rig_from_world = pycolmap.Rigid3d(pose_of_frame[frame.frame_id][:3])
            posed.add_frame(frame)
    for image in images:
        posed.add_image(image)
        posed.register_frame(image.frame_id)
    return posed
