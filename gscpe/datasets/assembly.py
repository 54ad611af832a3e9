# SPDX-License-Identifier: Apache-2.0
"""From what a reader found to a Dataset, alike for all readers."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Collection, Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.datasets.dataset import Dataset
from gscpe.datasets.photos import check_sizes
from gscpe.errors import DatasetError
from gscpe.geometry.camera import Camera
from gscpe.scene import References
from gscpe.scene.query_list import Query

_logger = logging.getLogger(__name__)


def make_dataset(
    *,
    name: str,
    scene: str,
    image_folder: Path,
    cameras: Mapping[str, Camera],
    truths: Mapping[str, Mapping[str, Float64Array]],
    queries: Collection[str],
    metres_per_unit: float | None = 1.0,
    split: str,
) -> Dataset:
    """A Dataset of photos on disk; those that are not queries are references.

    Args:
        cameras: of all photos, by name.
        truths: as in Dataset. Photos that the first does not know are left out, with one
            warning.
        queries: names of the query photos.
        split: as in Dataset; what is left out makes it incomplete.

    Raises:
        DatasetError: one side of the split is empty, or a photo is not of its camera's size.
    """
    posed = truths[next(iter(truths))]
    kept = sorted(photo for photo in cameras if photo in posed)
    lost = sorted(set(cameras) - set(kept))
    if lost:
        _logger.warning(
            "%s %s: %d of %d photos have no usable pose and are left out; the first is %s",
            *(name, scene, len(lost), len(cameras), lost[0]),
        )
    asked = set(queries)
    references = [photo for photo in kept if photo not in asked]
    if not references or len(references) == len(kept):
        what = "references" if not references else "queries"
        raise DatasetError(
            f"{name} {scene} in {image_folder}: no {what} are left of {len(cameras)} photos, "
            f"{len(lost)} of which have no usable pose; is the split right?"
        )
    check_sizes(image_folder, {photo: cameras[photo] for photo in kept})
    return Dataset(
        name=name,
        scene=scene,
        references=References(
            names=tuple(references),
            cam_from_world=np.stack([posed[photo] for photo in references]),
            cameras=tuple(cameras[photo] for photo in references),
        ),
        queries=tuple(Query(photo, cameras[photo]) for photo in kept if photo in asked),
        image_folder=image_folder,
        truths={
            truth: {photo: poses[photo] for photo in kept if photo in poses}
            for truth, poses in truths.items()
        },
        metres_per_unit=metres_per_unit,
        split=f"{split}, incomplete" if lost else split,
    )
