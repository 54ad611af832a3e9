# SPDX-License-Identifier: Apache-2.0
"""The photos of tools/ablate_training.py: learned from and left out, small, with poses by model."""

from __future__ import annotations

import functools
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np

from gscpe.arrays import Float64Array, IntArray
from gscpe.errors import ColmapModelError
from gscpe.mapping.reference_photos import at_most, reference_image, reference_photo
from gscpe.photos import Photo, write_image
from gscpe.photos.photo import LazyPhotos
from gscpe.poses import read_pose_file, write_colmap_folder
from gscpe.retrieval import describe_references
from gscpe.scene import GlobalDescriptors, References
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.query_list import read_query_list
from gscpe.training import PointCloud, read_colmap_points, triangulated_points

GIVEN, REFINED = "given", "refined"
BLOCKS, BLOCK, EVERY = 5, 5, 8


class Scene:
    """Small photos in a folder, their poses by model, and points to begin with.

    Args:
        name: for people.
        learned, queries: photos and their given poses.
        images, query_images: their folders.
        models: of the learned photos, by "given" and, maybe, "refined".
        metres_per_unit: None where it is not known.
        size: pixels of the longer side of the small photos, at most.
        work: folder to keep the small photos and the triangulated points in.
    """

    def __init__(
        self,
        name: str,
        learned: References,
        queries: References,
        images: Path,
        query_images: Path,
        models: Mapping[str, Path],
        metres_per_unit: float | None,
        size: int,
        work: Path,
    ) -> None:
        self.name, self.metres_per_unit, self.size = name, metres_per_unit, size
        self.folder = work / f"photos-{size}"
        self._work, self._models, self._images, self._originals = work, models, images, learned
        self.learned = _made_smaller(learned, images, size, self.folder)
        self.queries = _made_smaller(queries, query_images, size, self.folder)
        self._points: dict[str, PointCloud] = {}
        self._poses = {GIVEN: {**_by_name(learned), **_by_name(queries)}}
        if REFINED in models:
            self._poses[REFINED] = _by_name(read_colmap_references(models[REFINED], images))
            missing = {*learned.names} - {*self._poses[REFINED]}
            if missing:
                raise ColmapModelError(f"{models[REFINED]} has no pose of {min(missing)}")

    @property
    def truths(self) -> tuple[str, ...]:
        """The models that know the queries."""
        return tuple(
            model
            for model, poses in self._poses.items()
            if all(name.removesuffix(".png") in poses for name in self.queries.names)
        )

    def with_poses(self, references: References, model: str) -> References:
        """The references at the poses of a model."""
        poses = [self._poses[model][name.removesuffix(".png")] for name in references.names]
        return replace(references, cam_from_world=np.stack(poses))

    @functools.cached_property
    def photos(self) -> list[Photo]:
        """Those learned from."""
        return [reference_photo(self.learned, i, self.folder) for i in range(len(self.learned))]

    @functools.cached_property
    def descriptors(self) -> GlobalDescriptors:
        """Of the photos learned from; no pose changes them."""
        return describe_references(
            LazyPhotos(len(self.learned), lambda i: self.photos[i]), progress=True
        )

    def points(self, model: str) -> tuple[PointCloud, list[IntArray]]:
        """Points, and which of them each photo that is learned from sees: those of the model where
        it has some; or triangulated, of the photos learned from alone."""
        if model not in self._points:
            found = read_colmap_points(self._models[model])
            self._points[model] = found or self._triangulated(model)
        points = self._points[model]
        return points, points.seen_in(self._originals.names)

    def _triangulated(self, model: str) -> PointCloud:
        folder = self._work / f"points-{model}"
        file = folder / "points.npz"
        if not file.exists():
            names, cameras = self._originals.names, self._originals.cameras
            poses = {name: self._poses[model][name] for name in names}
            write_colmap_folder(folder, poses, dict(zip(names, cameras, strict=True)))
            print(f"triangulating points of {len(names)} photos", file=sys.stderr)
            found = triangulated_points(folder, self._images)
            seen: dict[str, Any] = {f"seen.{n}": array for n, array in found.seen_by_name.items()}
            np.savez(file, positions=found.positions, colours=found.colours, **seen)
        with np.load(file) as stored:
            known = {key[5:]: stored[key] for key in stored.files if key.startswith("seen.")}
            return PointCloud(stored["positions"], stored["colours"], known)


def redkitchen_scene(
    data: Path, reported: bool, refined: Path | None, size: int, work: Path
) -> Scene:
    """Blocks of consecutive references are left out; or the reported queries are."""
    model, images = data / "sparse" / "0", data / "references"
    every = read_colmap_references(model, images)
    left_out = [] if reported else in_blocks(len(every))
    queries, query_images = some(every, left_out), images
    if reported:
        listed, truth = read_query_list(data / "queries.txt"), read_pose_file(data / "truth.txt")
        queries = References(
            tuple(query.name for query in listed),
            np.stack([truth.poses[query.name] for query in listed]),
            tuple(query.camera for query in listed),
        )
        query_images = data / "queries"
    learned = some(every, sorted({*range(len(every))} - {*left_out}))
    models = _models(model, refined)
    return Scene("RedKitchen", learned, queries, images, query_images, models, 1.0, size, work)


def colmap_scene(
    name: str, model: Path, images: Path, refined: Path | None, size: int, work: Path
) -> Scene:
    """Every eighth photo is left out."""
    every = read_colmap_references(model, images)
    queries = some(every, range(0, len(every), EVERY))
    learned = some(every, [i for i in range(len(every)) if i % EVERY])
    models = _models(model, refined)
    return Scene(name, learned, queries, images, images, models, None, size, work)


def in_blocks(count: int) -> list[int]:
    """Indices of blocks of consecutive photos, spread over all."""
    middles = (np.arange(BLOCKS) + 0.5) * count / BLOCKS
    return sorted({int(middle) - BLOCK // 2 + k for middle in middles for k in range(BLOCK)})


def some(references: References, chosen: Sequence[int]) -> References:
    return References(
        tuple(references.names[i] for i in chosen),
        references.cam_from_world[list(chosen)],
        tuple(references.cameras[i] for i in chosen),
    )


def _models(given: Path, refined: Path | None) -> dict[str, Path]:
    return {GIVEN: given} if refined is None else {GIVEN: given, REFINED: refined}


def _by_name(references: References) -> dict[str, Float64Array]:
    return dict(zip(references.names, references.cam_from_world, strict=True))


def _made_smaller(references: References, images: Path, size: int, folder: Path) -> References:
    """The same photos as they are in the folder, where they are written if they are not there."""
    names, cameras = tuple(f"{name}.png" for name in references.names), []
    for index, name in enumerate(names):
        image, camera = at_most(
            reference_image(references, index, images), references.cameras[index], size
        )
        cameras.append(camera)
        if not (folder / name).exists():
            write_image(folder / name, image[:, :, :3])
    return References(names, references.cam_from_world, tuple(cameras))
