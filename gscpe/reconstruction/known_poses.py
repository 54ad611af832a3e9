# SPDX-License-Identifier: Apache-2.0
"""Photos whose poses are known before a map is made of them."""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError, ReconstructionError
from gscpe.geometry.camera import Camera
from gscpe.poses import write_colmap_folder


@dataclass(frozen=True)
class KnownPoses:
    """Photos whose poses are known already.

    Attributes:
        image_folder: of the photos.
        colmap: a COLMAP model of them; or
        poses, cameras: ``cam_from_world``, (4, 4), and camera by name.
        metres_per_unit: of the poses; None where it is not known.
    """

    image_folder: Path
    colmap: Path | None = None
    poses: Mapping[str, Float64Array] | None = None
    cameras: Mapping[str, Camera] | None = None
    metres_per_unit: float | None = 1.0


def known_model(source: KnownPoses, work: Path) -> Path:
    """A COLMAP model of the photos."""
    if source.colmap is not None:
        return source.colmap
    if not source.poses:
        raise PoseError(
            "there is no known pose: give a COLMAP model, or poses and cameras by photo"
        )
    missing = [name for name in source.poses if not (source.image_folder / name).is_file()]
    if missing:
        raise ReconstructionError(
            f"{len(missing)} of the {len(source.poses)} photos with known poses are not in "
            f"{source.image_folder}, the first is {missing[0]}"
        )
    folder = work / "known"
    shutil.rmtree(folder, ignore_errors=True)
    write_colmap_folder(folder, dict(sorted(source.poses.items())), source.cameras)
    return folder


def fingerprint(source: KnownPoses) -> str:
    """Changes with the poses and cameras, wherever they are from."""
    known = hashlib.sha256()
    if source.colmap is not None:
        for path in sorted(path for path in source.colmap.rglob("*") if path.is_file()):
            known.update(path.name.encode() + path.read_bytes())
    for name, pose in sorted((source.poses or {}).items()):
        known.update(name.encode() + np.asarray(pose, dtype=np.float64).tobytes())
    for name, camera in sorted((source.cameras or {}).items()):
        known.update(f"{name} {camera!r}".encode())
    return known.hexdigest()
