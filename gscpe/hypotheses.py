"""Where to begin: reference photos that show different places, best first."""

from __future__ import annotations

from typing import Iterator, Sequence

from gscpe.arrays import Float64Array
from gscpe.geometry.pose_error import pose_difference
from gscpe.pose_prior import PosePrior
from gscpe.retrieval import RetrievedReference

_SAME_PLACE_DEGREES = 30.0
_SIGMAS = 3.0


def different_places(
    retrieved: Sequence[RetrievedReference],
    cam_from_world: Float64Array,
    same_place: float,
) -> Iterator[RetrievedReference]:
    """One reference of each place, by rank: neighbours of one that was given are left out, for
    what failed from there would fail from beside it.

    Args:
        retrieved: references, best first.
        cam_from_world: (N, 4, 4) of all references.
        same_place: distance of camera centres, map units, below which two references that
            look the same way (within 30 degrees) show the same place.
    """
    given: list[Float64Array] = []
    for reference in retrieved:
        pose = cam_from_world[reference.index]
        differences = (pose_difference(pose, other) for other in given)
        if any(
            each.distance < same_place and each.degrees < _SAME_PLACE_DEGREES
            for each in differences
        ):
            continue
        given.append(pose)
        yield reference


def near_the_prior_first(
    retrieved: Sequence[RetrievedReference],
    cam_from_world: Float64Array,
    prior: PosePrior,
    same_place: float,
) -> list[RetrievedReference]:
    """The same references; those that the prior allows come first, in their order."""
    reach = _SIGMAS * prior.translation_sigma + same_place

    def is_far(reference: RetrievedReference) -> bool:
        apart = pose_difference(cam_from_world[reference.index], prior.cam_from_world)
        return apart.distance > reach

    return sorted(retrieved, key=is_far)
