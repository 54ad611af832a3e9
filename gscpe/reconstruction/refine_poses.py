# SPDX-License-Identifier: Apache-2.0
"""Photos whose poses are known roughly, from a device or a robot: the poses are refined."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import ReconstructionError
from gscpe.geometry.camera import Camera
from gscpe.geometry.neighbours import pairs_by_pose
from gscpe.given import real_path
from gscpe.reconstruction import colmap
from gscpe.reconstruction.disk import require_space
from gscpe.reconstruction.epipolar import read_matched_pairs
from gscpe.reconstruction.frame import ModelFrame, poses_of
from gscpe.reconstruction.known_poses import KnownPoses, fingerprint, known_model
from gscpe.reconstruction.masks import prepare_masks
from gscpe.reconstruction.pairs import choose_pairs, chosen_once
from gscpe.reconstruction.photos import Prepared, PreparedPhoto, prepared_once
from gscpe.reconstruction.pose_adjustment import Bounds, adjust_poses
from gscpe.reconstruction.pose_report import (
    agreement,
    checked_misfit,
    refined_poses,
    take_out_doubtful,
    why_not_refined,
)
from gscpe.reconstruction.posed_photos import prepare_posed_photos
from gscpe.reconstruction.result import (
    BYTES_A_PHOTO,
    FEW_FEATURES,
    RESULT,
    Clock,
    Reconstruction,
    read_result,
    stamp_of,
    why_not_placed,
    write_model,
    write_result,
)
from gscpe.reconstruction.settings import PoseRefinementSettings, ReconstructionSettings
from gscpe.reconstruction.work_folder import not_kept_if_refused, open_work_folder
from gscpe.scene.colmap_database import pycolmap_camera, set_cameras
from gscpe.scene.colmap_model import read_colmap_references

_LEAST_PHOTOS = 3
_RANKS = sorted({round(1.5**power) - 1 for power in range(12)})
"""Which of the nearest cameras a photo is matched with: all of the first, and fewer and fewer, up
to the 86th, so that a slow walk is matched over more than its last steps."""


def refine_known_poses(
    source: KnownPoses,
    folder: str | Path,
    settings: ReconstructionSettings | None = None,
    refinement: PoseRefinementSettings | None = None,
    masks: str | Path | None = None,
    *,
    resume: bool = False,
    progress: bool = False,
) -> Reconstruction:
    """Refines poses that are known but for some pixels, as devices and robots give them.

    Photos are matched where poses, looks or their order say that they show the same; points are
    triangulated at the poses as they are, then poses and points are adjusted, again and again with
    tighter bounds. The frame and the unit stay those of the poses that were given. Photos whose
    pose cannot be refined are not in the model.

    Args:
        source: photos, poses and cameras.
        folder: to write to, as :func:`gscpe.reconstruct`.
        settings: size of the photos, features, pairs.
        refinement: bounds.
        masks: folder of pictures named like the photos, black where these do not count.
        resume: go on with what is in the folder.
        progress: show bars.

    Raises:
        ReconstructionError: there are too few photos, they show nothing that others show too, or
            the poses do not fit them.
        PoseError: a photo has no camera.
        ColmapModelError: the model cannot be read, or is of other photos.
        PhotoError, CameraError: a mask cannot be used; a photo is of another size than its camera.
        OutputError: the folder is of something else, or the disk is full.
        MissingDependencyError: pycolmap is not installed.
    """
    colmap.require_pycolmap()
    settings = settings or ReconstructionSettings()
    refinement = refinement or PoseRefinementSettings()
    folder = Path(folder)
    open_work_folder(folder, _stamp(source, settings, refinement, masks), resume, RESULT)
    if (folder / RESULT).exists():
        return read_result(folder / RESULT)
    clock = Clock()
    with not_kept_if_refused(folder):
        photos, unusable, given = _prepared(source, folder, settings.max_size, clock, progress)
    database = folder / "database.db"
    _match(photos, given, folder, settings, masks, clock, progress)
    matched = read_matched_pairs(database)
    bounds = _bounds(photos, refinement, settings.seed)
    misfit = checked_misfit(matched, given, bounds.first, refinement.least_fit, len(photos))
    with clock.step("refining"), colmap.reported("poses cannot be refined", database):
        model = adjust_poses(database, given, misfit, bounds, progress)
        enough = set(poses_of(model))
        take_out_doubtful(model, matched, bounds.last, refinement.least_agreement)
        model.extract_colors_for_all_images(folder / "images")
    placed = poses_of(model)
    if len(placed) < _LEAST_PHOTOS:
        raise ReconstructionError(
            f"of {len(photos)} known poses, {len(placed)} can be refined: the photos share too "
            "little that is seen from two places. Were they all taken from one spot? More photos, "
            "half a step apart, would help"
        )
    features, shared = colmap.verified_pairs(database)
    reasons = why_not_placed(photos, unusable, set(placed), (), features, shared, settings)
    fit = agreement(matched, given, bounds.first)
    for name in reasons:
        if shared.get(name, 0) and features[name] >= FEW_FEATURES:
            reasons[name] = why_not_refined(fit[name], shared[name], bounds, name in enough)
    result = Reconstruction(
        model_folder=write_model(model, folder),
        image_folder=folder / "images",
        placed=tuple(placed),
        not_placed=reasons,
        other_models=(),
        points=model.num_points3D(),
        error=float(model.compute_mean_reprojection_error()),
        frame=ModelFrame(source.metres_per_unit, None),
        seconds=clock.seconds,
        refined=refined_poses(model, matched, given, placed),
    )
    write_result(folder / RESULT, result)
    return result


def _stamp(
    source: KnownPoses,
    settings: ReconstructionSettings,
    refinement: PoseRefinementSettings,
    masks: str | Path | None,
) -> dict[str, Any]:
    """What must be the same where a run is gone on with."""
    return {
        "photos": str(real_path(source.image_folder)),
        "poses": fingerprint(source),
        "refinement": asdict(refinement),
        **stamp_of(settings, masks),
    }


def _prepared(
    source: KnownPoses, folder: Path, max_size: int, clock: Clock, progress: bool
) -> tuple[list[PreparedPhoto], dict[str, str], dict[str, Float64Array]]:
    """Photos, why others cannot be used, and poses by name."""
    references = read_colmap_references(known_model(source, folder), source.image_folder)

    def prepare() -> Prepared:
        with clock.step("photos"):
            return prepare_posed_photos(
                references, source.image_folder, folder / "images", max_size, progress
            )

    photos, unusable = prepared_once(folder / "photos.json", prepare)
    if len(photos) < _LEAST_PHOTOS:
        why = f" ({next(iter(unusable.values()))})" if unusable else ""
        raise ReconstructionError(
            f"{len(photos)} usable photos with a pose are too few{why}: at least {_LEAST_PHOTOS} "
            "are needed"
        )
    known = dict(zip(references.names, references.cam_from_world, strict=True))
    return photos, unusable, {photo.name: known[_original(photo.name, known)] for photo in photos}


def _match(
    photos: Sequence[PreparedPhoto],
    given: Mapping[str, Float64Array],
    folder: Path,
    settings: ReconstructionSettings,
    masks: str | Path | None,
    clock: Clock,
    progress: bool,
) -> None:
    """Features, the cameras as they are known, and matches; into the database."""
    images, database = folder / "images", folder / "database.db"
    mask_folder = prepare_masks(photos, masks, folder)
    if not database.exists():
        require_space(folder, BYTES_A_PHOTO * len(photos))
    with clock.step("features"):
        colmap.extract(database, photos, images, mask_folder, settings, progress)
        cameras = {photo.name: pycolmap_camera(Camera.parse(photo.camera)) for photo in photos}
        set_cameras(database, cameras)
    with clock.step("matching"):
        pairs = chosen_once(
            folder / "pairs.json", lambda: _pairs(photos, images, given, settings, progress)
        )
        colmap.match(database, pairs, folder / "pairs.txt", progress)


def _bounds(
    photos: Sequence[PreparedPhoto], refinement: PoseRefinementSettings, seed: int
) -> Bounds:
    size = float(np.median([max(photo.width, photo.height) for photo in photos]))
    return Bounds(
        first=refinement.first_error * size,
        last=refinement.last_error * size,
        rounds=refinement.rounds,
        least_points=refinement.least_points,
        refine_focal_length=refinement.refine_focal_length,
        seed=seed,
    )


def _original(name: str, known: Mapping[str, Float64Array]) -> str:
    """Photos of some kinds are written as .jpg."""
    return name if name in known else name.removesuffix(".jpg")


def _pairs(
    photos: Sequence[PreparedPhoto],
    images: Path,
    given: Mapping[str, Float64Array],
    settings: ReconstructionSettings,
    progress: bool,
) -> list[tuple[str, str]]:
    """By looks and order, and by poses."""
    names = [photo.name for photo in photos]
    fewer = replace(
        settings, most_similar=(settings.most_similar + 1) // 2
    )  # poses tell the others
    chosen = dict.fromkeys(choose_pairs(photos, images, fewer, progress))
    if len(names) > settings.all_pairs_up_to:
        poses = np.stack([given[name] for name in names])
        chosen.update(dict.fromkeys((names[a], names[b]) for a, b in pairs_by_pose(poses, _RANKS)))
    return list(chosen)
