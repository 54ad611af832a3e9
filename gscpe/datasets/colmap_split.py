"""Any COLMAP model, split into references and queries, or with a query list of hloc's form."""

from __future__ import annotations

from pathlib import Path

from gscpe.datasets.assembly import make_dataset
from gscpe.datasets.dataset import Dataset
from gscpe.datasets.files import read_lines
from gscpe.datasets.photos import common_parent, photos_on_disk, relative_name
from gscpe.datasets.split import every_nth, every_nth_text
from gscpe.errors import DatasetError, SettingsError
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.pose_file import read_poses
from gscpe.scene.query_list import read_query_list

NAME = "COLMAP"


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
      Names are then relative to the folder that both image folders have in common, for example
      ``references/a.jpg`` and ``queries/b.jpg``.

    Args:
        model_folder: with cameras.bin or cameras.txt.
        image_folder: that the model's names are relative to; must hold all of them.
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
    cameras = dict(zip(model.names, model.cameras, strict=True))
    poses = dict(zip(model.names, model.cam_from_world, strict=True))
    parent = image_folder

    if queries is None or truth is None:
        if test_list is None:
            asked, split = every_nth(model.names, every), every_nth_text(every)
        else:
            split = "a list of queries"
            asked = _read_names(Path(test_list)) & frozenset(model.names)
            if not asked:
                raise DatasetError(f"{test_list}: no photo of {model_folder} is in this list")
    else:
        query_folder = image_folder if query_folder is None else Path(query_folder)
        parent = common_parent(image_folder, query_folder)
        asked_cameras = {query.name: query.camera for query in read_query_list(queries)}
        found = photos_on_disk(query_folder, asked_cameras, f"the folder that {queries} is of")
        to_name = {name: relative_name(parent, query_folder / n) for name, n in found.items()}
        true_poses = {to_name[n]: p for n, p in read_poses(truth).items() if n in to_name}
        if not true_poses:
            raise DatasetError(f"{truth} has no pose of a photo of {queries}")
        cameras = {relative_name(parent, image_folder / n): c for n, c in cameras.items()}
        both = sorted(set(cameras) & set(to_name.values()))
        if both:
            raise DatasetError(f"{both[0]} is in {model_folder} and in {queries}; leave one out")
        poses = {relative_name(parent, image_folder / n): p for n, p in poses.items()} | true_poses
        cameras |= {to_name[name]: asked_cameras[name] for name in found}
        asked = frozenset(to_name.values())
        split = "a list of queries"
    return make_dataset(
        name=NAME,
        scene=scene,
        image_folder=parent,
        cameras=cameras,
        truths={"colmap": poses},
        queries=asked,
        metres_per_unit=metres_per_unit,
        split=split,
    )


def _read_names(path: Path) -> frozenset[str]:
    return frozenset(line for _, line in read_lines(path, "you: a photo name a line"))
