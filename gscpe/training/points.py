# SPDX-License-Identifier: Apache-2.0
"""The points that training begins with."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np

from gscpe.arrays import Float64Array, IntArray, UInt8Array
from gscpe.errors import ColmapModelError, MissingDependencyError
from gscpe.geometry.pose_error import camera_centres
from gscpe.photos.photo_name import with_slashes
from gscpe.scene.colmap_files import read_colmap_files
from gscpe.splats.gaussians import SH_C0
from gscpe.training.parameters import Parameters
from gscpe.training.settings import TrainingSettings

LEAST_POINTS = 100
"""Fewer do not tell where things are."""

_LEAST_PHOTOS = 3
_MOST_ERROR = 2.0
"""A point that fewer photos see, or that is off by more pixels, does not say how deep they are."""


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Coloured points.

    Attributes:
        positions: (M, 3) float64, in the world, finite.
        colours: (M, 3) uint8.
        seen_by_name: indices of those that a photo sees and that are known well, by its name.

    Raises:
        ColmapModelError: shapes differ, a position is not finite, or there are fewer than
            LEAST_POINTS.
    """

    positions: Float64Array
    colours: UInt8Array
    seen_by_name: Mapping[str, IntArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.positions.shape != (len(self.positions), 3) or (
            self.positions.shape != self.colours.shape
        ):
            raise ColmapModelError("points need (M, 3) positions and as many colours")
        if len(self.positions) < LEAST_POINTS:
            raise ColmapModelError(
                f"{len(self.positions)} points are too few to start a training; at least "
                f"{LEAST_POINTS} are needed"
            )
        if not np.all(np.isfinite(self.positions)):
            raise ColmapModelError("some points are NaN or infinite; remove them from the model")

    def seen_in(self, names: Sequence[str]) -> list[IntArray]:
        """Indices of the points that each of these photos sees; of unknown photos, none."""
        nothing = np.zeros(0, dtype=np.intp)
        by_name = {with_slashes(name): indices for name, indices in self.seen_by_name.items()}
        return [by_name.get(with_slashes(name), nothing) for name in names]


def read_colmap_points(model_folder: str | Path) -> PointCloud | None:
    """The points of a COLMAP model, in the order of their numbers; None where it has fewer than
    LEAST_POINTS.

    Raises:
        MissingDependencyError: pycolmap is not installed.
        ColmapModelError: the model cannot be read.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise MissingDependencyError(
            "reading a COLMAP model needs pycolmap: pip install pycolmap"
        ) from error
    try:
        model = pycolmap.Reconstruction(str(model_folder))
    except Exception as error:  # pycolmap raises plain ValueError, RuntimeError, IndexError, ...
        raise ColmapModelError(
            f"{model_folder} is not a readable COLMAP model: {str(error).strip()}"
        ) from error
    if len(model.points3D) < LEAST_POINTS:
        return None
    # pycolmap ends names in text files at the first blank.
    _, images = read_colmap_files(Path(model_folder))
    return cloud_of(model, {image.image_id: image.name for image in images})


def cloud_of(model: Any, names: Mapping[int, str]) -> PointCloud:
    """The points of a pycolmap.Reconstruction, in the order of their numbers.

    Args:
        model: with points.
        names: of its photos, by their number.

    Raises:
        ColmapModelError: there are too few, or one is not finite.
    """
    points = [model.points3D[number] for number in sorted(model.points3D)]
    seen: dict[str, list[int]] = {}
    for index, point in enumerate(points):
        photos = {element.image_id for element in point.track.elements}
        if len(photos) >= _LEAST_PHOTOS and point.error <= _MOST_ERROR:
            for photo in photos:
                seen.setdefault(names[photo], []).append(index)
    return PointCloud(
        np.array([point.xyz for point in points], dtype=np.float64).reshape(-1, 3),
        np.array([point.color for point in points], dtype=np.uint8).reshape(-1, 3),
        {name: np.array(indices, dtype=np.intp) for name, indices in seen.items()},
    )


def first_gaussians(points: PointCloud, extent: float, settings: TrainingSettings) -> Parameters:
    """Round Gaussians at the points, as wide as their three nearest neighbours are away (Kerbl et
    al. 2023); points beyond the budget are left out, evenly.

    Args:
        points: where and in what colour.
        extent: of the cameras, units of the scene; nothing is wider than a tenth of it.
        settings: budget and opacity.
    """
    from scipy.spatial import cKDTree

    chosen = np.arange(len(points.positions))
    if len(chosen) > settings.max_gaussians:
        chosen = np.random.default_rng(settings.seed).permutation(chosen)
        chosen = np.sort(chosen[: settings.max_gaussians])
    positions = points.positions[chosen]
    distances, _ = cKDTree(positions).query(positions, k=4)
    widths = np.sqrt(np.mean(distances[:, 1:] ** 2, axis=1))
    widths = np.clip(widths, 1e-5 * extent, 0.1 * extent)
    count = len(chosen)
    quaternions = np.zeros((count, 4), dtype=np.float32)
    quaternions[:, 0] = 1.0
    colours = points.colours[chosen].astype(np.float32) / 255.0
    logit = np.log(settings.first_opacity / (1.0 - settings.first_opacity))
    log_scales = np.repeat(np.log(widths)[:, None], 3, axis=1)
    return Parameters.new(
        means=positions.astype(np.float32),
        log_scales=log_scales.astype(np.float32),
        quaternions=quaternions,
        logits=np.full(count, logit, dtype=np.float32),
        sh=np.asarray((colours - 0.5) / np.float32(SH_C0), dtype=np.float32)[:, None, :],
    ).in_spatial_order()


def extent_of(cam_from_world: Float64Array) -> float:
    """1.1 times the largest distance of a camera from their mean, scene units, as in 3DGS."""
    centres = camera_centres(cam_from_world)
    radius = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    return 1.1 * radius


__all__ = ["PointCloud", "extent_of", "first_gaussians", "read_colmap_points"]
