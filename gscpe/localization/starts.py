# SPDX-License-Identifier: Apache-2.0
"""Where to begin: a prior pose, or reference photos that show different places, best first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, Iterator, Literal

import numpy as np
from numpy.typing import ArrayLike

from gscpe.arrays import Float64Array, short_repr
from gscpe.errors import PoseError
from gscpe.geometry.pose_error import camera_centre, camera_centres, pose_difference
from gscpe.geometry.se3 import check_transform
from gscpe.retrieval import RetrievedReference

StartedFrom = Literal["reference", "prior", "tracking"]

_NO_ROTATION_DEGREES = 180.0


@dataclass(frozen=True, eq=False)
class Start:
    """Where an attempt begins.

    Attributes:
        kind: ``"reference"``: a reference photo; ``"prior"``: the pose that the caller gave;
            ``"tracking"``: that pose, near enough to need no coarse stage.
        cam_from_world: (4, 4).
        reference: name of the reference photo, None for the other kinds.
    """

    kind: StartedFrom
    cam_from_world: Float64Array
    reference: str | None = None

    def __repr__(self) -> str:
        return short_repr(self)


@dataclass(frozen=True, eq=False)
class PosePrior:
    """An approximate pose and its standard deviations. It only sets where the search starts.

    Attributes:
        cam_from_world: (4, 4) rigid transform; it is copied, and the copy cannot be changed.
        translation_sigma: standard deviation of the camera's centre along each axis, world units.
        rotation_sigma_degrees: standard deviation of its rotation; 180 if the rotation is unknown,
            see :meth:`at`.

    Raises:
        PoseError: the pose is not a rigid transform, or a deviation is not one positive number.
    """

    cam_from_world: Float64Array
    translation_sigma: float = 0.05
    rotation_sigma_degrees: float = 2.0

    def __post_init__(self) -> None:
        pose = check_transform(self.cam_from_world, "the prior's cam_from_world").copy()
        pose.setflags(write=False)
        object.__setattr__(self, "cam_from_world", pose)
        for name in ("translation_sigma", "rotation_sigma_degrees"):
            object.__setattr__(self, name, _positive(getattr(self, name), name))

    @classmethod
    def at(cls, centre: ArrayLike, translation_sigma: float) -> PosePrior:
        """A position alone, as GPS gives it: references near it are tried first.

        Args:
            centre: (3,), where the camera is in the world, world units; not the translation of
                ``cam_from_world``.
            translation_sigma: its standard deviation along each axis, world units.

        Raises:
            PoseError: there are not three finite numbers, or the deviation is not positive.
        """
        try:
            position = np.asarray(centre, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise PoseError(f"a camera's centre must be (3,) numbers ({error})") from None
        if position.shape != (3,):
            raise PoseError(f"a camera's centre must be (3,) numbers, not {position.shape}")
        cam_from_world = np.eye(4)
        cam_from_world[:3, 3] = -position
        return cls(cam_from_world, translation_sigma, _NO_ROTATION_DEGREES)

    def __repr__(self) -> str:
        centre = ", ".join(f"{number:.6g}" for number in camera_centre(self.cam_from_world))
        return (
            f"PosePrior(centre ({centre}) +- {self.translation_sigma:g}, "
            f"rotation +- {self.rotation_sigma_degrees:g} degrees)"
        )


def _positive(sigma: float, name: str) -> float:
    if np.ndim(sigma) != 0:
        raise PoseError(
            f"a prior's {name} must be one number for all directions; give the largest of {sigma}"
        )
    try:
        number = float(sigma)
    except (TypeError, ValueError):
        number = np.nan
    if not 0 < number < np.inf:
        raise PoseError(f"a prior's {name} must be positive and finite, not {sigma!r}")
    return number


def different_places(
    ranking: Iterable[RetrievedReference],
    cam_from_world: Float64Array,
    same_place: float,
    same_place_degrees: float,
) -> Iterator[RetrievedReference]:
    """One reference of each place, by rank: neighbours of one that was given are left out, for
    what failed from there would fail from beside it.

    Args:
        ranking: references, best first; no more are taken than are needed.
        cam_from_world: (N, 4, 4) of all references.
        same_place: distance of camera centres, map units, below which two references that
            look the same way show the same place.
        same_place_degrees: angle between two cameras up to which they look the same way.
    """
    rotations = cam_from_world[:, :3, :3]
    centres = camera_centres(cam_from_world)
    # |R - S|_F = 2 sqrt(2) sin(angle / 2)
    same_way = 2.0 * np.sqrt(2.0) * np.sin(0.5 * np.radians(min(same_place_degrees, 180.0)))
    shown = np.zeros(len(cam_from_world), dtype=bool)
    for reference in ranking:
        if shown[reference.index]:
            continue
        yield reference
        near = np.linalg.norm(centres - centres[reference.index], axis=1) < same_place
        turned = np.linalg.norm(rotations - rotations[reference.index], axis=(1, 2))
        shown |= near & (turned < same_way)
        shown[reference.index] = True


def near_the_prior_first(
    ranking: Iterable[RetrievedReference],
    cam_from_world: Float64Array,
    prior: PosePrior,
    reach: float,
) -> list[RetrievedReference]:
    """The same references; those whose cameras are within ``reach`` of the prior's, map units,
    come first, in their order."""

    def is_far(reference: RetrievedReference) -> bool:
        apart = pose_difference(cam_from_world[reference.index], prior.cam_from_world)
        return apart.distance > reach

    return sorted(ranking, key=is_far)
