# SPDX-License-Identifier: Apache-2.0
"""From a COLMAP model and its photos to a splat file."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscpe.errors import OutputError, SettingsError, TrainingError
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.image_file import read_image_of
from gscpe.scene.photo import Photo, resized_photo, to_photo
from gscpe.scene.references import References
from gscpe.scene.write_splat import write_splat
from gscpe.training.evaluation import Likeness, likeness
from gscpe.training.loop import LEAST_PHOTOS, train
from gscpe.training.points import read_colmap_points
from gscpe.training.progress import Listener, Progress
from gscpe.training.settings import TrainingSettings
from gscpe.training.triangulation import triangulated_points

_log = logging.getLogger(__name__)

_MOST_EVALUATED = 50


@dataclass(frozen=True)
class TrainedSplat:
    """What came of it.

    Attributes:
        gaussians: their number.
        iterations: of the training, all starts together; 0 if the checkpoint was at the end.
        learned: photos that it was trained on.
        left_out: photos that it was not.
        likeness: of those left out; of some that it was trained on, where none were.
    """

    gaussians: int
    iterations: int
    learned: int
    left_out: int
    likeness: Likeness


def checkpoint_of(output: Path) -> Path:
    """The checkpoint beside a splat that is being trained."""
    return output.with_name(output.name + ".checkpoint")


def train_from_colmap(
    model_folder: str | Path,
    image_folder: str | Path,
    output: str | Path,
    settings: TrainingSettings | None = None,
    max_size: int = 1000,
    test_every: int = 0,
    resume: bool = False,
    progress: Listener | None = None,
) -> TrainedSplat:
    """Trains a splat on the registered photos of a COLMAP model and writes it.

    Where the model has no points, they are triangulated. A checkpoint lies beside ``output`` until
    the splat is written.

    Args:
        model_folder: with cameras, images and points.
        image_folder: the model's photos.
        output: ``.ply`` or ``.spz``.
        settings: how.
        max_size: longer side of the photos, pixels; larger ones are shrunk.
        test_every: the first of each so many photos is left out, to see how well the splat shows
            what it has not seen; 0 for none.
        resume: go on from the checkpoint.
        progress: is told of every iteration.

    Raises:
        ColmapModelError: the model cannot be read, is of other photos, or has no points
            and none can be triangulated.
        PhotoError, CameraError: a photo cannot be read, or is of another size than in the model.
        TrainingError: too few photos; the checkpoint does not fit.
        SettingsError: max_size or test_every is out of its range.
        OutputError: checkpoint or splat cannot be written; a checkpoint is in the way.
    """
    output = Path(output)
    if output.suffix.lower() not in (".ply", ".spz"):
        raise OutputError(f"{output}: splats are written as .ply or .spz")
    if max_size < 32:
        raise SettingsError(f"photos need at least 32 pixels, not max_size {max_size}")
    if test_every < 0 or test_every == 1:
        raise SettingsError(f"test_every must be 0, or 2 and more, not {test_every}")
    checkpoint = checkpoint_of(output)
    if checkpoint.exists() and not resume:
        raise OutputError(
            f"{checkpoint} belongs to an interrupted training: continue with --resume, or delete it"
        )
    references = read_colmap_references(model_folder, image_folder)
    test = [i for i in range(len(references)) if test_every and i % test_every == 0]
    learn = [i for i in range(len(references)) if not test_every or i % test_every]
    if len(learn) < LEAST_PHOTOS:
        raise TrainingError(
            f"{model_folder} has {len(references)} photos with a pose, of which {len(learn)} can "
            f"be trained on; at least {LEAST_PHOTOS} are needed"
        )
    points = read_colmap_points(model_folder)
    if points is None:
        _log.warning("%s has too few points: triangulating some", model_folder)
        points = triangulated_points(model_folder, image_folder)
    photos = [_photo(references, i, Path(image_folder), max_size) for i in learn]
    poses = references.cam_from_world
    last: list[Progress] = []

    def tell(news: Progress) -> None:
        last[:] = [news]
        if progress is not None:
            progress(news)

    depths = points.seen_in([references.names[i] for i in learn])
    scene = train(photos, poses[learn], points, settings, tell, checkpoint, resume, seen=depths)
    write_splat(scene, output)
    checkpoint.unlink()
    if test:
        seen = [_photo(references, i, Path(image_folder), max_size) for i in test]
        alike = likeness(scene, seen, poses[test])
    else:
        some = np.linspace(0, len(learn) - 1, min(len(learn), _MOST_EVALUATED)).astype(int)
        alike = likeness(scene, [photos[i] for i in some], poses[learn][some])
    iterations = last[0].iteration if last else 0
    return TrainedSplat(len(scene), iterations, len(learn), len(test), alike)


def _photo(references: References, index: int, folder: Path, max_size: int) -> Photo:
    path = folder / references.names[index]
    camera = references.cameras[index]
    image = read_image_of(path, camera)
    camera.check_fits(image.shape, f"photo {path}")
    photo = to_photo(image, camera)
    scale = max_size / max(camera.width, camera.height)
    return resized_photo(photo, scale) if scale < 1.0 else photo
