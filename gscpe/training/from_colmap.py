# SPDX-License-Identifier: Apache-2.0
"""From a COLMAP model and its photos to a splat file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gscpe.errors import OutputError, SettingsError
from gscpe.geometry.spread import evenly_spread
from gscpe.photos.masks import check_masks
from gscpe.ranges import check_test_every
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.training.evaluation import Likeness, likeness
from gscpe.training.from_references import (
    checkpoint_of,
    read_photos,
    split_references,
    train_references,
)
from gscpe.training.progress import Listener, Progress
from gscpe.training.settings import TrainingSettings

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


def train_from_colmap(
    model_folder: str | Path,
    image_folder: str | Path,
    output: str | Path,
    settings: TrainingSettings | None = None,
    max_size: int = 1000,
    test_every: int = 0,
    *,
    resume: bool = False,
    progress: Listener | None = None,
    masks: str | Path | None = None,
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
        masks: folder of pictures named like the photos, black where these do not count.

    Raises:
        ColmapModelError: the model cannot be read, is of other photos, or has no points
            and none can be triangulated.
        PhotoError, CameraError: a photo or its mask cannot be read, or is of another size than in
            the model; there are no masks of these photos.
        TrainingError: too few photos; the checkpoint does not fit.
        SettingsError: max_size or test_every is out of its range.
        OutputError: checkpoint or splat cannot be written; a checkpoint is in the way.
    """
    output = Path(output)
    if output.suffix.lower() not in (".ply", ".spz"):
        raise OutputError(f"{output}: splats are written as .ply or .spz")
    if max_size < 32:
        raise SettingsError(f"photos need at least 32 pixels, not max_size {max_size}")
    check_test_every(test_every)
    checkpoint = checkpoint_of(output)
    if checkpoint.exists() and not resume:
        raise OutputError(
            f"{checkpoint} belongs to an interrupted training: continue with --resume, or delete it"
        )
    references = read_colmap_references(model_folder, image_folder)
    learned, left_out = split_references(references, test_every)
    if masks is not None:
        check_masks(Path(masks), list(references.names))
    last: list[Progress] = []

    def tell(news: Progress) -> None:
        last[:] = [news]
        if progress is not None:
            progress(news)

    settings = settings or TrainingSettings()
    scene = train_references(
        learned,
        model_folder,
        image_folder,
        output,
        settings,
        max_size,
        masks,
        resume=resume,
        progress=tell,
    )
    compared, which = left_out, list(range(len(left_out)))
    if not which:
        compared, which = learned, evenly_spread(len(learned), _MOST_EVALUATED)
    seen = read_photos(compared, image_folder, max_size, masks, which)
    alike = likeness(scene, seen, compared.cam_from_world[which])
    iterations = last[0].iteration if last else 0
    return TrainedSplat(len(scene), iterations, len(learned), len(left_out), alike)
