# SPDX-License-Identifier: Apache-2.0
"""What tells how large a model is, and where: nothing, GPS, known poses, a known distance of two
photos or of two points, or depth images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Collection, Mapping, Sequence

import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.errors import ReconstructionError, SettingsError
from gscpe.geometry.alignment import umeyama
from gscpe.geometry.pose_error import camera_centres
from gscpe.geometry.similarity_transform import Similarity
from gscpe.photos.gps import local_metres
from gscpe.photos.photo_name import with_slashes
from gscpe.poses import read_pose_file
from gscpe.reconstruction.lengths import KnownLengths, read_lengths

_TRIALS = 500
_LEAST = 3
_SIGMAS = 2.5
_MOST_GPS_ERROR = 0.25  # of the spread of the positions


@dataclass(frozen=True)
class ScaleSource:
    """Where a model's unit comes from; see :meth:`parse`.

    Attributes:
        kind: "unknown", "gps", "poses", "distance", "points" or "depth".
        poses: file of known poses.
        between: two photos whose distance is known, ...
        metres: ... and how far apart they were taken.
        lengths: between points that photos show.
        depth: folder of depth images, ...
        per_metre: ... and what a metre is in them.
    """

    kind: str = "unknown"
    poses: Path | None = None
    between: tuple[str, str] = ("", "")
    metres: float = 0.0
    lengths: KnownLengths | None = None
    depth: Path | None = None
    per_metre: float = 1000.0

    @classmethod
    def parse(cls, text: str | None) -> ScaleSource:
        """Of ``unknown``, ``gps`` (of the photos' EXIF), ``distance:PHOTO,PHOTO,METRES``,
        ``points:FILE`` (see :func:`gscpe.read_lengths`), ``depth:FOLDER`` (of depth images in
        millimetres; ``depth:FOLDER,5000`` where a metre is 5000), or the path of a file with known
        poses of some of the photos.

        Raises:
            SettingsError: it is none of these.
        """
        if text in (None, "", "unknown"):
            return cls()
        assert text is not None
        if text == "gps":
            return cls("gps")
        if text.startswith("depth:"):
            return cls._of_depth(text)
        if text.startswith("points:"):
            return cls("points", lengths=read_lengths(Path(text.removeprefix("points:"))))
        if text.startswith("distance:"):
            parts = [part.strip() for part in text.removeprefix("distance:").split(",")]
            try:
                first, second, metres = parts[0], parts[1], float(parts[2])
            except (IndexError, ValueError):
                first, second, metres = "", "", 0.0
            if len(parts) != 3 or first == second or not 0 < metres < np.inf:
                raise SettingsError(
                    f"{text!r} is not of the form distance:PHOTO,PHOTO,METRES, for example "
                    "distance:IMG_1.jpg,IMG_9.jpg,2.5"
                )
            return cls("distance", between=(first, second), metres=metres)
        if not Path(text).is_file():
            raise SettingsError(
                f"there is no file of known poses {text}; a scale is from gps, "
                "distance:PHOTO,PHOTO,METRES, points:FILE, depth:FOLDER, or such a file"
            )
        return cls("poses", poses=Path(text))

    @classmethod
    def _of_depth(cls, text: str) -> ScaleSource:
        folder, per_metre = Path(text.removeprefix("depth:")), 1000.0
        name, comma, number = str(folder).rpartition(",")
        if comma and not folder.is_dir():  # a folder's name may have a comma
            folder = Path(name)
            try:
                per_metre = float(number)
            except ValueError:
                per_metre = 0.0
        if not 0 < per_metre < np.inf:
            raise SettingsError(
                f"{text!r} is not of the form depth:FOLDER or depth:FOLDER,PER_METRE, for example "
                "depth:depth,5000"
            )
        if not folder.is_dir():
            raise SettingsError(f"there is no folder of depth images {folder}")
        return cls("depth", depth=folder, per_metre=per_metre)


def scaled_like_poses(cam_from_world: Mapping[str, Float64Array], path: Path) -> Similarity:
    """The similarity from a model's frame to that of known poses, by the positions of the photos
    that both have; a few wrong ones do no harm.

    Raises:
        PoseError: the file cannot be read.
        ReconstructionError: it has too few of the photos, they stand on one line, or do not fit.
    """
    known = read_pose_file(path).poses
    names = [name for name in cam_from_world if name in known]
    check_known_poses(path, names, list(cam_from_world))
    ours = camera_centres(np.stack([cam_from_world[name] for name in names]))
    theirs = camera_centres(np.stack([known[name] for name in names]))
    for positions, whose in ((ours, "were placed"), (theirs, "are known")):
        spread = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
        if spread[1] < 0.01 * spread[0]:
            raise ReconstructionError(
                f"the photos whose poses {whose} stand on one line: that does not tell how the "
                f"model is turned about it; add one beside it to {path}"
            )
    moved, inliers = robust_similarity(ours, theirs)
    if np.count_nonzero(inliers) < max(_LEAST, 0.5 * len(names)):
        raise ReconstructionError(
            f"the poses in {path} do not fit the photos: of {len(names)}, only "
            f"{np.count_nonzero(inliers)} agree. Are they world to camera, and of these photos?"
        )
    return moved


def scaled_like_gps(
    level: Mapping[str, Float64Array], gps: Mapping[str, tuple[float, float, float]]
) -> tuple[Similarity, tuple[float, float, float]]:
    """The similarity from a model whose z axis points up to east, north and up in metres; and the
    origin of these, latitude, longitude and altitude.

    The cameras know better what is level than satellites do: only turned about the z axis.

    Args:
        level: ``cam_from_world`` of the photos.
        gps: latitude, longitude and altitude of some of them.

    Raises:
        ReconstructionError: too few photos have a position, or the positions are spread too little
            for how inexact they are.
    """
    names = [name for name in level if name in gps]
    check_gps(len(names), len(level))
    positions = np.array([gps[name] for name in names], dtype=np.float64)
    origin = np.median(positions, axis=0)
    theirs = local_metres(positions, origin)
    ours = camera_centres(np.stack([level[name] for name in names]))
    flat_ours, flat_theirs = ours * (1.0, 1.0, 0.0), theirs * (1.0, 1.0, 0.0)
    moved, inliers = robust_similarity(flat_ours, flat_theirs, about_z=True)
    misses = np.linalg.norm(moved.apply(flat_ours) - flat_theirs, axis=1)
    spread = np.sqrt(np.mean(np.sum((flat_theirs - flat_theirs.mean(axis=0)) ** 2, axis=1)))
    if spread <= 0 or np.median(misses) > _MOST_GPS_ERROR * spread:
        raise ReconstructionError(
            f"the GPS positions do not tell the scale: they are spread over {spread:.1f} m, and "
            f"{np.median(misses):.1f} m off (median); without --scale-from it stays unknown"
        )
    height = np.median(theirs[inliers, 2] - moved.scale * ours[inliers, 2])
    translation = moved.translation + np.array([0.0, 0.0, height])
    return Similarity(moved.scale, moved.rotation, translation), (
        float(origin[0]),
        float(origin[1]),
        float(origin[2]),
    )


def scaled_by_distance(
    cam_from_world: Mapping[str, Float64Array], source: ScaleSource
) -> Similarity:
    """The scaling that makes two photos stand as far apart as they are known to.

    Raises:
        ReconstructionError: one of them was not placed, or both stand in one place.
    """
    names = [placed_name(name, cam_from_world) for name in source.between]
    first, second = camera_centres(np.stack([cam_from_world[name] for name in names]))
    apart = float(np.linalg.norm(first - second))
    if apart < 1e-9:
        raise ReconstructionError(f"{' and '.join(source.between)} were taken from one place")
    return Similarity(source.metres / apart, np.eye(3), np.zeros(3))


def check_known_poses(path: Path, known: Sequence[str], photos: Sequence[str]) -> None:
    """Of a file with known poses of some photos, by the names that both have.

    Raises:
        ReconstructionError: they are too few.
    """
    if len(known) < _LEAST:
        raise ReconstructionError(
            f"{path} has the poses of {len(known)} of the {len(photos)} photos that can be "
            f"compared, and at least {_LEAST} are needed; names must be the photos' own, for "
            f"example {photos[0]}"
        )


def check_gps(known: int, photos: int) -> None:
    """Of photos that have a GPS position.

    Raises:
        ReconstructionError: they are too few.
    """
    if known < _LEAST:
        raise ReconstructionError(
            f"{known} of the {photos} photos that can be compared have a GPS position in their "
            f"EXIF, and at least {_LEAST} are needed; messengers remove it: take the originals"
        )


def name_in_model(name: str, names: Collection[str]) -> str | None:
    """The name that a photo has in the model, if it is there: that of a HEIC photo has another
    ending."""
    slashes = with_slashes(name)
    return next((known for known in (name, slashes, f"{slashes}.jpg") if known in names), None)


def placed_name(name: str, placed: Collection[str]) -> str:
    """As :func:`name_in_model`.

    Raises:
        ReconstructionError: it was not placed.
    """
    known = name_in_model(name, placed)
    if known is None:
        raise ReconstructionError(
            f"{name}, which --scale-from names, was not placed; name one that was, for example "
            f"{next(iter(placed))}"
        )
    return known


def robust_similarity(
    points_a: Float64Array, points_b: Float64Array, about_z: bool = False
) -> tuple[Similarity, BoolArray]:
    """The similarity from a to b that most points agree with: least median of squares over samples,
    then least squares over what fits (Rousseeuw and Leroy, 1987).

    Args:
        points_a, points_b: (N, 3) corresponding points.
        about_z: turn about the z axis alone; all points have z = 0.

    Returns:
        The similarity, and which points agree with it, (N,).
    """
    rng = np.random.default_rng(0)
    count, size = len(points_a), 2 if about_z else 3
    fit = _about_z if about_z else umeyama
    best, least = fit(points_a, points_b), np.inf
    for trial in range(_TRIALS):
        some = np.arange(count) if trial == 0 else rng.choice(count, size, replace=False)
        tried = fit(points_a[some], points_b[some])
        misses = np.linalg.norm(tried.apply(points_a) - points_b, axis=1)
        median = float(np.median(misses))
        if median < least:
            best, least = tried, median
    # Few points beyond those that the sample fits look better than they are.
    reach = _SIGMAS * (1.0 + 5.0 / max(count - size, 1)) * max(least, 1e-9)
    inliers = np.linalg.norm(best.apply(points_a) - points_b, axis=1) <= reach
    if np.count_nonzero(inliers) >= size:
        best = fit(points_a[inliers], points_b[inliers])
    return best, np.asarray(inliers)


def _about_z(points_a: Float64Array, points_b: Float64Array) -> Similarity:
    """Least squares in the plane, as complex numbers."""
    a, b = (points[:, 0] + 1j * points[:, 1] for points in (points_a, points_b))
    mean_a, mean_b = a.mean(), b.mean()
    spread = float(np.sum(np.abs(a - mean_a) ** 2))
    factor = np.sum(np.conj(a - mean_a) * (b - mean_b)) / spread if spread > 0 else 1.0 + 0j
    scale, angle = float(np.abs(factor)) or 1.0, float(np.angle(factor))
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    shift = mean_b - scale * np.exp(1j * angle) * mean_a
    return Similarity(scale, rotation, np.array([shift.real, shift.imag, 0.0]))
