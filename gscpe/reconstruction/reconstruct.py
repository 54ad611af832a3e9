# SPDX-License-Identifier: Apache-2.0
"""From photos or a video to their poses and a cloud of points."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np

from gscpe.errors import ReconstructionError
from gscpe.reconstruction import colmap
from gscpe.reconstruction.disk import require_space, when_full
from gscpe.reconstruction.frame import poses_of, settle_frame
from gscpe.reconstruction.masks import prepare_masks
from gscpe.reconstruction.pairs import choose_pairs, chosen_once
from gscpe.reconstruction.parallax import parallax
from gscpe.reconstruction.photos import (
    Prepared,
    PreparedPhoto,
    prepare_photos,
    prepared_once,
)
from gscpe.reconstruction.result import (
    BYTES_A_PHOTO,
    FEW_FEATURES,
    RESULT,
    Clock,
    Reconstruction,
    stamp_of,
    why_not_placed,
    write_model,
    write_result,
)
from gscpe.reconstruction.scale import ScaleSource
from gscpe.reconstruction.scale_check import check_scale_source
from gscpe.reconstruction.settings import ReconstructionSettings
from gscpe.reconstruction.sources import find_source
from gscpe.reconstruction.work_folder import (
    not_kept_if_refused,
    open_work_folder,
    read_kept,
    write_kept,
)

_LEAST_PHOTOS = 3
_LEAST_PARALLAX = 0.003  # 0.0006 for a mere turn, 0.016 to 0.025 for walks in and around houses


def reconstruct(
    source: str | Path | Sequence[str | Path],
    folder: str | Path,
    settings: ReconstructionSettings | None = None,
    scale: ScaleSource | None = None,
    masks: str | Path | None = None,
    *,
    resume: bool = False,
    progress: bool = False,
) -> Reconstruction:
    """Structure from motion of photos or videos, by pycolmap, on the CPU.

    Photos are turned upright, shrunk, sorted by camera (EXIF and size; photos of one size that say
    nothing are taken to be of one camera) and matched with those that look alike or come next.
    After Ctrl-C, or a full disk, ``resume`` does not do again what is finished.

    Args:
        source: folders of photos, videos, or single photos.
        folder: to write to: the model in ``sparse/0``, the photos in ``images``, and
            ``reconstruction.json``, which says what came of each.
        settings: how.
        scale: where the unit comes from; by default it stays unknown.
        masks: folder of pictures named like the photos, black where these do not count.
        resume: go on with what is in the folder.
        progress: show bars.

    Raises:
        ReconstructionError: there are too few photos, all are blurred, they do not overlap or are
            from one spot; a video cannot be decoded or hardly moves; the scale cannot be found.
        PhotoError: a mask cannot be used.
        OutputError: the folder is of something else, or the disk is full.
        MissingDependencyError: pycolmap is not installed.
    """
    colmap.require_pycolmap()
    settings, scale = settings or ReconstructionSettings(), scale or ScaleSource()
    found = find_source([source] if isinstance(source, str | Path) else source)
    folder = Path(folder)
    stamp = {"photos": found.stamp(), **stamp_of(settings, masks)}
    open_work_folder(folder, stamp, resume, RESULT)
    clock = Clock()
    images, database = folder / "images", folder / "database.db"

    def prepare() -> Prepared:
        with clock.step("photos"):
            return prepare_photos(found, images, settings, progress)

    with not_kept_if_refused(folder):
        photos, unusable = prepared_once(folder / "photos.json", prepare)
    check_scale_source(scale, photos, unusable)
    mask_folder = prepare_masks(photos, masks, folder)
    by_size = _put_together(photos, folder, mask_folder, settings, clock, progress)
    features, shared = colmap.verified_pairs(database)
    if not by_size or by_size[0].num_reg_images() < _LEAST_PHOTOS:
        raise ReconstructionError(_why_none(photos, features, shared))
    model, *others = by_size
    placed_names = tuple(poses_of(model))
    _check_parallax(database, placed_names)
    apart = tuple(
        tuple(name for name in poses_of(other) if name not in placed_names) for other in others
    )
    gps = {photo.name: photo.gps for photo in photos if photo.gps is not None}
    sizes = {photo.name: photo.full_size for photo in photos if photo.full_size is not None}
    frame = settle_frame(model, scale, gps, sizes)
    result = Reconstruction(
        model_folder=write_model(model, folder),
        image_folder=images,
        placed=placed_names,
        not_placed=why_not_placed(
            photos, unusable, set(placed_names), apart, features, shared, settings
        ),
        other_models=tuple(names for names in apart if names),
        points=model.num_points3D(),
        error=float(model.compute_mean_reprojection_error()),
        frame=frame,
        seconds=clock.seconds,
    )
    write_result(folder / RESULT, result)
    return result


def _put_together(
    photos: Sequence[PreparedPhoto],
    folder: Path,
    mask_folder: Path | None,
    settings: ReconstructionSettings,
    clock: Clock,
    progress: bool,
) -> list[Any]:
    """Models of photos that hang together, pycolmap.Reconstruction, largest first. What is in the
    folder already is not done again."""
    images, database, models = folder / "images", folder / "database.db", folder / "models"
    done = models / "done.json"
    if not done.exists():
        if not database.exists():
            require_space(folder, BYTES_A_PHOTO * len(photos))
        with clock.step("features"):
            colmap.extract(database, photos, images, mask_folder, settings, progress)
        with clock.step("matching"):
            pairs = chosen_once(
                folder / "pairs.json", lambda: choose_pairs(photos, images, settings, progress)
            )
            colmap.match(database, pairs, folder / "pairs.txt", progress)
        with clock.step("placing"):
            shutil.rmtree(models, ignore_errors=True)
            placed = colmap.place(database, images, models, settings, len(photos), progress)
        with when_full(done):
            for number, each in enumerate(placed):
                target = models / f"by-size-{number}"
                target.mkdir(parents=True)
                each.write(str(target))
        write_kept(done, len(placed))
    count = int(read_kept(done))
    read = colmap.require_pycolmap().Reconstruction
    return [read(str(models / f"by-size-{number}")) for number in range(count)]


def _check_parallax(database: Path, names: Sequence[str]) -> None:
    """Raises ReconstructionError where photos are from one spot: what a model says of distances is
    made up then."""
    moved = parallax(database, set(names))
    if moved < _LEAST_PARALLAX:
        raise ReconstructionError(
            f"the {len(names)} photos that hang together were taken from one spot: what they share "
            f"moves by {moved:.2%} of the picture beyond what turning the camera does, which does "
            "not tell how far it is. Step sideways between two photos, do not only turn"
        )


def _why_none(
    photos: Sequence[PreparedPhoto], features: Mapping[str, int], shared: Mapping[str, int]
) -> str:
    """Why no model came of the photos, and what to do."""
    if np.median([features.get(photo.name, 0) for photo in photos]) < FEW_FEATURES:
        return (
            f"the {len(photos)} photos have hardly any features: they are blank, dark or blurred. "
            "Take them in more light, of things with texture"
        )
    overlapping = sum(shared.get(photo.name, 0) > 0 for photo in photos)
    if overlapping < _LEAST_PHOTOS:
        return (
            f"the photos do not overlap: {overlapping} of {len(photos)} show something that "
            "another shows too. Each place must be in three photos and more, from half a step apart"
        )
    return (
        f"{overlapping} of {len(photos)} photos overlap, but their poses cannot be told: were they "
        "all taken from one spot? Step sideways between two photos, do not only turn"
    )
