# SPDX-License-Identifier: Apache-2.0
"""Structure from motion through pycolmap, in steps that can be interrupted and go on.

All that is found goes into a database, step by step; what is there is not done again.
"""

from __future__ import annotations

import itertools
import sqlite3
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterator, Sequence

from tqdm import tqdm

from gscpe.cores import available_cores
from gscpe.errors import MissingDependencyError, OutputError, ReconstructionError
from gscpe.reconstruction.disk import is_full
from gscpe.reconstruction.photos import PreparedPhoto
from gscpe.reconstruction.settings import ReconstructionSettings
from gscpe.scene.colmap_database import numbered_names, restore_names

_AT_ONCE = 4  # photos a core
_PAIRS_AT_ONCE = 60
_LEAST_MODEL = 3


def require_pycolmap() -> Any:
    """The module.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise MissingDependencyError(
            "putting photos together needs pycolmap: pip install pycolmap (there is no wheel for "
            "Arm Linux: make the model elsewhere, and give it with --colmap)"
        ) from error
    return pycolmap


def extract(
    database: Path,
    photos: Sequence[PreparedPhoto],
    image_folder: Path,
    mask_folder: Path | None,
    settings: ReconstructionSettings,
    progress: bool,
) -> None:
    """Cameras, photos and their SIFT features; one camera for all photos that share theirs."""
    pycolmap = require_pycolmap()
    cores = available_cores()
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = cores
    options.sift.max_num_features = settings.max_features
    done: dict[str, int] = {}
    with reported("features cannot be extracted", database):
        restore_names(database)
        with pycolmap.Database.open(database) as stored:
            for image in stored.read_all_images():
                if stored.exists_keypoints(image.image_id):  # and not killed before
                    done[image.name] = image.camera_id
        bar = tqdm(total=len(photos), desc="features", unit="photo", disable=not progress)
        with bar:
            bar.update(len(done))
            groups: dict[tuple[str, int, int], list[PreparedPhoto]] = {}
            for photo in photos:
                groups.setdefault((photo.camera, photo.width, photo.height), []).append(photo)
            for group in groups.values():
                camera = next((done[photo.name] for photo in group if photo.name in done), None)
                todo = [photo for photo in group if photo.name not in done]
                while todo:
                    # The first alone, so that its camera is there for the others.
                    count = 1 if camera is None else _AT_ONCE * cores
                    some, todo = todo[:count], todo[count:]
                    reader = _reader_options(group, mask_folder, camera)
                    pycolmap.extract_features(
                        database,
                        image_folder,
                        [photo.name for photo in some],
                        camera_mode=pycolmap.CameraMode.SINGLE,
                        reader_options=reader,
                        extraction_options=options,
                        device=pycolmap.Device.cpu,
                    )
                    if camera is None:
                        with pycolmap.Database.open(database) as stored:
                            first = stored.read_image_with_name(some[0].name)
                            camera = None if first is None else first.camera_id
                    bar.update(len(some))


def _reader_options(
    group: Sequence[PreparedPhoto], mask_folder: Path | None, camera: int | None
) -> Any:
    pycolmap = require_pycolmap()
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    if mask_folder is not None:
        reader.mask_path = str(mask_folder)
    if camera is not None:
        reader.existing_camera_id = camera
        return reader
    known = sorted(photo.focal for photo in group if photo.focal is not None)
    if known:
        width, height = group[0].width, group[0].height
        reader.camera_params = f"{known[len(known) // 2]},{width / 2},{height / 2},0"
    return reader


def match(
    database: Path, pairs: Sequence[tuple[str, str]], list_file: Path, progress: bool
) -> None:
    """Features matched, and two views verified, of these pairs of photos."""
    pycolmap = require_pycolmap()
    options = pycolmap.FeatureMatchingOptions()
    options.num_threads = available_cores()
    with reported("photos cannot be matched", database):
        with pycolmap.Database.open(database) as stored:
            ids = {image.name: image.image_id for image in stored.read_all_images()}
            todo = [
                (a, b)
                for a, b in pairs
                if a in ids and b in ids and not stored.exists_two_view_geometry(ids[a], ids[b])
            ]
        bar = tqdm(total=len(pairs), desc="matching", unit="pair", disable=not progress)
        with bar, numbered_names(database) as numbers:
            bar.update(len(pairs) - len(todo))
            for some in _batches(todo, _PAIRS_AT_ONCE):
                list_file.write_text("".join(f"{numbers[a]} {numbers[b]}\n" for a, b in some))
                pairing = pycolmap.ImportedPairingOptions()
                pairing.match_list_path = str(list_file)
                pycolmap.match_image_pairs(
                    database,
                    matching_options=options,
                    pairing_options=pairing,
                    device=pycolmap.Device.cpu,
                )
                bar.update(len(some))


def place(
    database: Path,
    image_folder: Path,
    models_folder: Path,
    settings: ReconstructionSettings,
    photos: int,
    progress: bool,
) -> list[Any]:
    """Models of the photos that hang together, pycolmap.Reconstruction, largest first.

    Photo after photo: the global mapper (GLOMAP) took 3.4 times as long for COLMAP's Gerrard Hall,
    and folded the symmetric building.
    """
    pycolmap = require_pycolmap()
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = available_cores()
    options.random_seed = settings.seed
    options.min_model_size = _LEAST_MODEL
    with reported("photos cannot be placed", database):
        models_folder.mkdir(parents=True, exist_ok=True)
        bar = tqdm(total=photos, desc="placing photos", unit="photo", disable=not progress)
        with bar:
            models = pycolmap.incremental_mapping(
                database,
                image_folder,
                models_folder,
                options,
                initial_image_pair_callback=lambda: bar.update(2) and None,
                next_image_callback=lambda: bar.update(1) and None,
            )
    return sorted(models.values(), key=lambda model: -model.num_reg_images())


def verified_pairs(database: Path) -> tuple[dict[str, int], dict[str, int]]:
    """By photo: how many features it has, and with how many others it shows the same."""
    pycolmap = require_pycolmap()
    with pycolmap.Database.open(database) as stored:
        images = {image.image_id: image.name for image in stored.read_all_images()}
        features = {name: stored.num_keypoints_for_image(i) for i, name in images.items()}
        shared = dict.fromkeys(images.values(), 0)
        pairs, inliers = stored.read_two_view_geometry_num_inliers()
        for pair, count in zip(pairs, inliers, strict=True):
            if count > 0:
                for number in pycolmap.pair_id_to_image_pair(pair):
                    shared[images[number]] += 1
    return features, shared


def _batches(items: Sequence[tuple[str, str]], size: int) -> Iterator[tuple[tuple[str, str], ...]]:
    iterator = iter(items)
    while some := tuple(itertools.islice(iterator, size)):
        yield some


@contextmanager
def reported(what: str, database: Path) -> Iterator[None]:
    """pycolmap keeps quiet meanwhile; its plain errors become ours.

    Args:
        what: cannot be done then.
        database: that is worked with.
    """
    pycolmap = require_pycolmap()
    logged = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = 3  # it would tell of each photo
    try:
        yield
    except (RuntimeError, ValueError, OSError, IndexError, sqlite3.Error) as error:
        if is_full(database.parent) or "disk is full" in str(error):
            raise OutputError(
                f"the disk of {database.parent} is full; make room, and go on with --resume"
            ) from error
        raise ReconstructionError(
            f"{what}: {' '.join(str(error).split())}; if this comes again, delete "
            f"{database.parent} and begin anew"
        ) from error
    finally:
        pycolmap.logging.minloglevel = logged
