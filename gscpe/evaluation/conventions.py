# SPDX-License-Identifier: Apache-2.0
"""Whether poses are wrong because they are of another convention, or of another world.

Inverted poses, a quaternion in another order, and OpenGL's axes are plain mistakes with large
errors, which look like the result of a bad method. Each is undone in turn, alone and together, with
and without the motion that best fits one set of cameras to the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Callable, Iterator, Literal, Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.alignment import umeyama
from gscpe.geometry.pose_error import camera_centres
from gscpe.geometry.similarity_transform import Similarity
from gscpe.geometry.spread import evenly_spread

Convention = Literal["inverted", "quaternion", "opengl"]

_CHANGES: tuple[Convention, ...] = ("quaternion", "inverted", "opengl")
"""In the order in which they are undone."""

_GAIN = 0.2
"""The errors must fall to this share for a convention to be named."""

_GOOD = 0.25
"""... and to this: in radians, and in typical distances of the cameras from their middle."""

_SIMPLER = 2.0
"""A simpler explanation is preferred if its errors are at most so many times larger."""

_NOTHING = 1e-6
"""Errors, in the same measure, that rounding makes."""

_PHOTOS = 2
_PHOTOS_FOR_A_MOTION = 4
"""A motion has 6 or 7 numbers to fit to the 6 of each photo."""

_VOTES = 40
"""Photos whose rotation is tried as that of a motion."""

_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Explanation:
    """What seems to be wrong, and what the errors would be without.

    Attributes:
        changes: what is undone: "inverted" (camera to world), "quaternion" (the real part last),
            "opengl" (axes: y up, z backward).
        motion: that also brings the cameras onto the true ones; None where none is needed.
        of_truth: whether the true poses are the ones that are wrong.
        median_distance, median_degrees: of the errors then; the unit is that of the poses.
    """

    changes: tuple[Convention, ...]
    motion: Similarity | None
    of_truth: bool
    median_distance: float
    median_degrees: float


def explain_errors(
    estimates: Mapping[str, Float64Array], truth: Mapping[str, Float64Array]
) -> Explanation | None:
    """What would make the estimates fit the truth far better, if anything would.

    Args:
        estimates, truth: ``cam_from_world``, (4, 4), by name; names of one alone do not count.
    """
    names = [name for name in truth if name in estimates]
    if len(names) < _PHOTOS:
        return None
    a = np.stack([estimates[name] for name in names])
    b = np.stack([truth[name] for name in names])
    now = _cost(*_medians(a, b), _spread(b))
    if now <= _NOTHING:
        return None
    found = list(_candidates(a, b))
    best = min(cost for _, cost in found)
    if best > min(_GAIN * now, _GOOD):
        return None
    limit = min(max(_SIMPLER * best, _NOTHING), _GAIN * now)
    return next(explanation for explanation, cost in found if cost <= limit)


def _candidates(
    estimates: Float64Array, truth: Float64Array
) -> Iterator[tuple[Explanation, float]]:
    """All that is tried, with its cost: first what needs no motion, then what needs no scale;
    of these, fewer changes first, and then what is wrong with the estimates.

    Undoing the order of a quaternion is not its own inverse, so the truth has its turns too.
    """
    switches = sorted(product((False, True), repeat=len(_CHANGES)), key=sum)
    sides = (estimates, truth, False), (truth, estimates, True)
    for kind in ("none", "rigid", "similar"):
        if kind != "none" and len(truth) < _PHOTOS_FOR_A_MOTION:
            return
        for switch, (poses, target, of_truth) in product(switches, sides):
            changes = tuple(c for c, on in zip(_CHANGES, switch, strict=True) if on)
            changed, motion = poses, None
            for change in changes:
                changed = _UNDO[change](changed)
            if kind != "none":
                motion = _fit(changed, target, kind == "similar")
                changed = motion.cam_from_b(changed)
            if changes or motion is not None:
                medians = _medians(changed, target)
                cost = _cost(*medians, _spread(target))
                yield Explanation(changes, motion, of_truth, *medians), cost


def _fit(poses: Float64Array, target: Float64Array, with_scale: bool) -> Similarity:
    """The motion of most cameras: up to half of them may be anywhere.

    The rotation that is nearest to those of all photos, and the medians of scale and shift; or
    the least squares of the half that fits best then, where that is better.
    """
    a, b = camera_centres(poses), camera_centres(target)
    turns = np.swapaxes(target[:, :3, :3], 1, 2) @ poses[:, :3, :3]
    votes = turns[evenly_spread(len(turns), _VOTES)]
    # |R - S|_F grows with the angle between two rotations.
    apart = [np.median(np.linalg.norm(turns - vote, axis=(1, 2))) for vote in votes]
    rotation = votes[int(np.argmin(apart))]
    scale = _spread(target) / _spread(poses) if with_scale else 1.0
    first = Similarity(scale, rotation, np.median(b - scale * a @ rotation.T, axis=0))
    misses = np.linalg.norm(first.apply(a) - b, axis=1)
    half = np.argsort(misses)[: max(3, (len(a) + 1) // 2)]
    second = umeyama(a[half], b[half], with_scale)
    spread = _spread(target)
    return min(
        (first, second),
        key=lambda motion: _cost(*_medians(motion.cam_from_b(poses), target), spread),
    )


def _cost(distance: float, degrees: float, spread: float) -> float:
    return distance / spread + float(np.radians(degrees))


def _spread(poses: Float64Array) -> float:
    """The typical distance of the cameras from their middle; 1 where all are in one place."""
    centres = camera_centres(poses)
    distances = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
    size = float(np.median(distances))
    return size if size > 1e-9 * float(np.abs(centres).max(initial=1.0)) else 1.0


def _medians(poses: Float64Array, target: Float64Array) -> tuple[float, float]:
    """As :func:`gscpe.geometry.pose_error.pose_difference` of each, for all at once."""
    distances = np.linalg.norm(camera_centres(poses) - camera_centres(target), axis=1)
    half_sines = np.linalg.norm(poses[:, :3, :3] - target[:, :3, :3], axis=(1, 2)) / np.sqrt(8.0)
    angles = 2.0 * np.arcsin(np.minimum(1.0, half_sines))
    return float(np.median(distances)), float(np.degrees(np.median(angles)))


def _inverted(poses: Float64Array) -> Float64Array:
    inverse = poses.copy()
    inverse[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
    inverse[:, :3, 3] = camera_centres(poses)
    return inverse


def _with_real_part_last(poses: Float64Array) -> Float64Array:
    """The poses whose quaternions x y z w were read as w x y z."""
    from scipy.spatial.transform import Rotation

    wxyz = Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)
    changed = poses.copy()
    changed[:, :3, :3] = Rotation.from_quat(wxyz, scalar_first=False).as_matrix()
    return changed


def _with_opencv_axes(poses: Float64Array) -> Float64Array:
    return np.asarray(_OPENGL @ poses)


_UNDO: Mapping[Convention, Callable[[Float64Array], Float64Array]] = {
    "quaternion": _with_real_part_last,
    "inverted": _inverted,
    "opengl": _with_opencv_axes,
}
