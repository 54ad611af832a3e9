# SPDX-License-Identifier: Apache-2.0
"""Any COLMAP model, split into references and queries, or with a query list of hloc's form."""

from __future__ import annotations

import logging
from pathlib import Path

from gscpe.datasets.assembly import make_dataset
from gscpe.datasets.dataset import Dataset
from gscpe.datasets.files import read_lines
from gscpe.datasets.photos import check_sizes, photos_on_disk
from gscpe.datasets.split import every_nth, every_nth_text
from gscpe.errors import DatasetError, SettingsError
from gscpe.photos.photo_name import with_slashes
from gscpe.poses.hloc import read_poses
from gscpe.scene import References
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.query_list import Query, fit_queries, read_query_list

NAME = "COLMAP"
TRUTH = "colmap"

_logger = logging.getLogger(__name__)


def read_colmap(
    model_folder: str | Path,
    image_folder: str | Path,
    every: int | None = None,
    test_list: str | Path | None = None,
    queries: str | Path | None = None,
    truth: str | Path | None = None,
    query_folder: str | Path | None = None,
    metres_per_unit: float | None = None,
    scene: str | None = None,
) -> Dataset:
    """The photos of a COLMAP model, and one of three kinds of queries.

    - ``every``: every n-th of the sorted names is a query, the first to begin with; 8 unless
      another is given.
    - ``test_list``: a text file of names, one a line; names that the model lacks are left out.
    - ``queries`` and ``truth``: all photos of the model are references. Queries are those of an
      hloc list (``name MODEL width height params...``) in ``query_folder`` (None: the image
      folder), and ``truth`` holds their poses (``name qw qx qy qz tx ty tz``, world to camera).

    Args:
        model_folder: with cameras.bin or cameras.txt.
        image_folder: that the model's names are relative to; must hold all of them. Photos may
            be larger or smaller than the model says, all by one factor.
        metres_per_unit: of the model; None: unknown.
        scene: name of the scene; None: that of the folder around the image folder.

    Raises:
        DatasetError: no references or no queries are left, or a file is missing.
        SettingsError: arguments contradict each other.
        ColmapModelError, QueryListError, PoseError, MissingDependencyError: one of the files
            cannot be read.
    """
    image_folder = Path(image_folder)
    if sum(given is not None for given in (every, test_list, queries)) > 1:
        raise SettingsError("give one of every, test_list and queries, not several")
    if (queries is None) != (truth is None):
        raise SettingsError("queries and truth belong together: give both, or neither")
    if query_folder is not None and queries is None:
        raise SettingsError("query_folder needs queries and truth")
    scene = image_folder.absolute().parent.name if scene is None else scene
    model = read_colmap_references(model_folder, image_folder)
    if queries is not None and truth is not None:
        own = image_folder if query_folder is None else Path(query_folder)
        return _with_queries(
            model, image_folder, Path(queries), Path(truth), own, metres_per_unit, scene
        )
    if test_list is None:
        asked, split = every_nth(model.names, every), every_nth_text(every)
    else:
        split = "a list of queries"
        asked = _read_names(Path(test_list)) & frozenset(model.names)
        if not asked:
            raise DatasetError(f"{test_list}: no photo of {model_folder} is in this list")
    return make_dataset(
        name=NAME,
        scene=scene,
        image_folder=image_folder,
        cameras=dict(zip(model.names, model.cameras, strict=True)),
        truths={TRUTH: dict(zip(model.names, model.cam_from_world, strict=True))},
        queries=asked,
        metres_per_unit=metres_per_unit,
        split=split,
    )


def _with_queries(
    model: References,
    image_folder: Path,
    queries: Path,
    truth: Path,
    query_folder: Path,
    metres_per_unit: float | None,
    scene: str,
) -> Dataset:
    """All photos of the model are references; those of a list, with a true pose, are queries."""
    cameras = {query.name: query.camera for query in read_query_list(queries, None, query_folder)}
    found = photos_on_disk(query_folder, cameras, f"the folder that {queries} is of")
    true_poses = read_poses(truth)
    known = {found[name]: name for name in found if name in true_poses}
    if not known:
        raise DatasetError(f"{truth} has no pose of a photo of {queries}")
    if len(known) < len(cameras):
        _logger.warning(
            "%d of the %d photos of %s are missing or have no pose in %s, and are left out",
            *(len(cameras) - len(known), len(cameras), queries, truth),
        )
    listed = [Query(photo, cameras[name]) for photo, name in known.items()]
    asked = {query.name: query.camera for query in fit_queries(listed, query_folder)}
    check_sizes(query_folder, asked)
    return Dataset(
        name=NAME,
        scene=scene,
        references=model,
        queries=tuple(Query(photo, camera) for photo, camera in sorted(asked.items())),
        image_folder=image_folder,
        truths={TRUTH: {photo: true_poses[name] for photo, name in known.items()}},
        metres_per_unit=metres_per_unit,
        query_folder=query_folder,
        split="a list of queries",
    )


def _read_names(path: Path) -> frozenset[str]:
    lines = (line for _, line in read_lines(path, "you: a photo name a line"))
    return frozenset(with_slashes(line.rstrip(", ")) for line in lines)
