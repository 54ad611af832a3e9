# SPDX-License-Identifier: Apache-2.0
"""From photos with known poses to a splat file: what every training of a model's photos does."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Sequence

import numpy as np

from gscpe.errors import TrainingError
from gscpe.photos.image_file import read_image_of
from gscpe.photos.masks import masked_image
from gscpe.photos.photo import Photo, resized_photo, to_photo
from gscpe.photos.photo_name import named_like
from gscpe.scene.references import References
from gscpe.splats.gaussians import GaussianScene
from gscpe.splats.write_splat import write_splat
from gscpe.training.loop import LEAST_PHOTOS, train
from gscpe.training.points import PointCloud, read_colmap_points
from gscpe.training.progress import Listener
from gscpe.training.settings import TrainingSettings
from gscpe.training.triangulation import triangulated_points

_log = logging.getLogger(__name__)


def checkpoint_of(output: Path) -> Path:
    """The checkpoint beside a splat that is being trained."""
    return output.with_name(output.name + ".checkpoint")


def split_references(references: References, test_every: int) -> tuple[References, References]:
    """Those that are trained on, and those that are left out: the first of so many, by name; none
    for 0.

    Raises:
        TrainingError: too few remain.
    """
    indices = np.arange(len(references))
    out = indices % test_every == 0 if test_every else np.zeros(len(references), dtype=bool)
    learned, left_out = (_some(references, indices[chosen]) for chosen in (~out, out))
    if len(learned) < LEAST_PHOTOS:
        raise TrainingError(
            f"{len(references)} photos have a pose, of which {len(learned)} can be trained on; at "
            f"least {LEAST_PHOTOS} are needed"
            + (" (--test-every 0 leaves none out)" if len(references) >= LEAST_PHOTOS else "")
        )
    return learned, left_out


def first_points(model_folder: str | Path, image_folder: str | Path) -> PointCloud:
    """The points of a COLMAP model; where it has too few, they are triangulated.

    Raises:
        MissingDependencyError: pycolmap is not installed.
        ColmapModelError: the model cannot be read, or none can be triangulated.
    """
    points = read_colmap_points(model_folder)
    if points is None:
        _log.warning("%s has too few points: triangulating some", model_folder)
        points = triangulated_points(model_folder, image_folder)
    return points


def read_photos(
    references: References,
    image_folder: str | Path,
    max_size: int,
    masks: str | Path | None = None,
    which: Sequence[int] | None = None,
) -> list[Photo]:
    """Photos of references as they are trained on, or compared with.

    Args:
        references: names and cameras.
        image_folder: of the photos.
        max_size: longer side, pixels; larger ones are shrunk.
        masks: folder of pictures named like the photos, black where these do not count.
        which: indices; None for all.

    Raises:
        PhotoError, CameraError: a photo or its mask cannot be read, or is of another size.
    """
    folder = Path(image_folder)
    photos = []
    for index in range(len(references)) if which is None else which:
        name, camera = references.names[index], references.cameras[index]
        image = read_image_of(folder / name, camera)
        camera.check_fits(image.shape, f"photo {folder / name}")
        mask = None if masks is None else named_like(Path(masks), name)
        photo = to_photo(image if mask is None else masked_image(image, mask), camera)
        scale = max_size / max(photo.camera.width, photo.camera.height)
        photos.append(resized_photo(photo, scale) if scale < 1.0 else photo)
    return photos


def train_references(
    learned: References,
    model_folder: str | Path,
    image_folder: str | Path,
    output: Path,
    settings: TrainingSettings,
    max_size: int,
    masks: str | Path | None = None,
    *,
    resume: bool = False,
    progress: Listener | None = None,
) -> GaussianScene:
    """Trains a splat on photos of a COLMAP model and writes it; a checkpoint lies beside it until
    then.

    Args:
        learned: the photos' names, poses and cameras.
        model_folder: its points are begun with, see :func:`first_points`.
        image_folder, max_size, masks: of the photos, see :func:`read_photos`.
        output: ``.ply`` or ``.spz``.
        settings: how.
        resume: go on from the checkpoint.
        progress: is told of every iteration.

    Raises:
        ColmapModelError, PhotoError, CameraError: of these functions.
        TrainingError: too few photos; the checkpoint does not fit.
        OutputError: checkpoint or splat cannot be written.
    """
    points = first_points(model_folder, image_folder)
    photos = read_photos(learned, image_folder, max_size, masks)
    checkpoint = checkpoint_of(output)
    poses = learned.cam_from_world
    seen = points.seen_in(learned.names)
    scene = train(photos, poses, points, settings, progress, checkpoint, resume=resume, seen=seen)
    write_splat(scene, output)
    checkpoint.unlink()
    return scene


def _some(references: References, indices: Sequence[int]) -> References:
    return References(
        tuple(references.names[i] for i in indices),
        references.cam_from_world[indices],
        tuple(references.cameras[i] for i in indices),
    )
