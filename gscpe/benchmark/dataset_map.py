# SPDX-License-Identifier: Apache-2.0
"""The map of a data set's references, made anew only where something has changed."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

from gscpe.batch.fingerprint import photo_fingerprint
from gscpe.benchmark.settings import BenchmarkSettings
from gscpe.datasets import Dataset
from gscpe.errors import OutputError, SplatError
from gscpe.mapping import MapSettings, build_map, check_frames, check_map, with_fitting_axes
from gscpe.retrieval import check_method
from gscpe.scene import open_map, save_map
from gscpe.scene.map_folder import check_map_output
from gscpe.splats import read_splat
from gscpe.splats.splat_kind import may_have_other_axes

_log = logging.getLogger(__name__)


def ensure_map(
    dataset: Dataset,
    splat: str | Path,
    folder: Path,
    settings: BenchmarkSettings,
    progress: bool,
) -> None:
    """Writes the map of a splat and the data set's references to a folder.

    What it was made of is noted beside it; where nothing of that has changed, and the settings
    say resume, the map is kept.

    Raises:
        SplatError, PhotoError, MapError, ModelError: the splat or the photos cannot be used, or do
            not fit together.
        OutputError: the map cannot be written.
    """
    recipe = _recipe(dataset, Path(splat), settings)
    note = folder.with_name(folder.name + ".made-of")
    if settings.resume and folder.is_dir() and note.is_file() and note.read_text() == recipe:
        _log.info("keeping %s: it was made from the same input", folder)
        return
    check_map_output(folder)
    check_method(settings.retrieval)
    scene = read_splat(splat)
    if settings.check_frames:
        scene = with_fitting_axes(
            scene,
            dataset.references,
            dataset.image_folder,
            metres_per_unit=dataset.metres_per_unit,
            backend=settings.backend,
            progress=progress,
            axes_are_open=may_have_other_axes(splat),
        )
        check_frames(
            scene,
            dataset.references,
            dataset.image_folder,
            metres_per_unit=dataset.metres_per_unit,
            backend=settings.backend,
            matcher=settings.matcher,
            progress=progress,
        )
    map_settings = MapSettings(
        retrieval=settings.retrieval, metres_per_unit=dataset.metres_per_unit
    )
    map_ = build_map(
        scene, dataset.references, dataset.image_folder, map_settings, progress=progress
    )
    try:
        note.unlink(missing_ok=True)
        save_map(map_, folder)
        note.write_text(recipe)
    except OSError as error:
        raise OutputError(f"{note} cannot be written: {error.strerror}") from error
    if settings.check_frames:
        _check_what_was_written(folder, dataset, settings, progress)


def _check_what_was_written(
    folder: Path, dataset: Dataset, settings: BenchmarkSettings, progress: bool
) -> None:
    """A map that is not good is benchmarked all the same: its numbers will say how bad it is."""
    check = check_map(
        open_map(folder),
        dataset.image_folder,
        backend=settings.backend,
        matcher=settings.matcher,
        progress=progress,
    )
    if check.good:
        _log.info("%s", check)
    else:
        _log.warning("%s is not good: %s", folder, check)


def _recipe(dataset: Dataset, splat: Path, settings: BenchmarkSettings) -> str:
    """A hash of all that a map is made of."""
    known = hashlib.sha256()
    try:
        with splat.open("rb") as file:
            known.update(hashlib.file_digest(file, "sha256").digest())
    except OSError as error:
        raise SplatError(f"splat {splat} cannot be read: {error.strerror}") from error
    references = dataset.references
    known.update(references.cam_from_world.tobytes())
    cameras = [camera.colmap_text() for camera in references.cameras]
    photos = [photo_fingerprint(dataset.image_folder / name) for name in references.names]
    known.update(repr((references.names, cameras, photos)).encode())
    known.update(repr((settings.retrieval, dataset.metres_per_unit)).encode())
    return known.hexdigest() + "\n"
