"""Where to begin: a prior pose, or reference photos that show different places, best first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, Iterator, Literal

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.geometry.pose_error import pose_difference
from gscpe.geometry.se3 import check_transform
from gscpe.retrieval import RetrievedReference

StartedFrom = Literal["reference", "prior", "tracking"]


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


@dataclass(frozen=True, eq=False)
class PosePrior:
    """A pose and how far off it may be. It says where to begin, and never outweighs the photo.

    Attributes:
        cam_from_world: (4, 4) rigid transform.
        translation_sigma: standard deviation of the camera's centre, in the unit of the pose.
        rotation_sigma_degrees: standard deviation of its rotation.

    Raises:
        PoseError: the pose is not a rigid transform, or a deviation is not positive.
    """

    cam_from_world: Float64Array
    translation_sigma: float = 0.05
    rotation_sigma_degrees: float = 2.0

    def __post_init__(self) -> None:
        check_transform(self.cam_from_world, "the prior's cam_from_world")
        for sigma in (self.translation_sigma, self.rotation_sigma_degrees):
            if not 0 < sigma < np.inf:
                raise PoseError(f"a prior's deviations must be positive and finite, not {sigma}")


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
    centres = -np.einsum("nji,nj->ni", rotations, cam_from_world[:, :3, 3])
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
