# SPDX-License-Identifier: Apache-2.0
"""How well poses and photos fit, before and after: in numbers, and in words."""

from __future__ import annotations

from typing import Any, Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import ReconstructionError
from gscpe.geometry.pose_error import camera_centre, rotation_angle_degrees
from gscpe.reconstruction.epipolar import MatchedPairs
from gscpe.reconstruction.frame import poses_of
from gscpe.reconstruction.pose_adjustment import Bounds, image_points
from gscpe.reconstruction.result import RefinedPoses


def checked_misfit(
    matched: MatchedPairs,
    given: Mapping[str, Float64Array],
    bound: float,
    least: float,
    photos: int,
) -> float:
    """Median distance of the matches from where the poses want them, pixels.

    Raises:
        ReconstructionError: there are none, or too few agree with the poses.
    """
    if not matched.names:
        raise ReconstructionError(
            f"the {photos} photos do not overlap: none shows what another shows too. Each place "
            "must be in three photos and more, from half a step apart"
        )
    errors = np.concatenate(matched.errors(given))
    share = float(np.mean(errors <= bound))
    if share < least:
        raise ReconstructionError(
            f"the poses do not fit the photos: {share:.0%} of the matches between photos agree "
            f"with them within {bound:.1f} px, and {least:.0%} are needed. Are they world to "
            "camera (gscpe convert-poses), of these very photos, and are the cameras theirs? "
            "Without --poses and --colmap, they are found from the photos alone"
        )
    return float(np.median(errors[errors <= bound]))


def agreement(
    matched: MatchedPairs, poses: Mapping[str, Float64Array], bound: float
) -> dict[str, float]:
    """By photo: the share of its matches that agree with these poses."""
    agree: dict[str, int] = {}
    count: dict[str, int] = {}
    for names, errors in zip(matched.names, matched.errors(poses), strict=True):
        for name in names:
            agree[name] = agree.get(name, 0) + int(np.count_nonzero(errors <= bound))
            count[name] = count.get(name, 0) + len(errors)
    return {name: agree[name] / number for name, number in count.items() if number}


def take_out_doubtful(model: Any, matched: MatchedPairs, bound: float, least: float) -> None:
    """Takes photos out of a pycolmap.Reconstruction of whose matches a lesser share than ``least``
    agrees with its poses within ``bound`` pixels."""
    agree = agreement(matched, poses_of(model), bound)
    for image in list(model.images.values()):
        if image.has_pose and agree.get(str(image.name), 0.0) < least:
            model.deregister_frame(image.frame_id)


def why_not_refined(fit: float, others: int, bounds: Bounds, was_found: bool) -> str:
    """In words.

    Args:
        fit: share of the photo's matches that agree with the pose that was given.
        others: how many photos show something that it shows too.
        bounds: what was asked for.
        was_found: it saw enough points, but too few of its matches agreed in the end.
    """
    if fit < 0.5 or was_found:
        return (
            f"does not fit its pose: {fit:.0%} of its matches with {others} other photos agree "
            f"with it within {bounds.first:.1f} px"
        )
    return (
        f"shares something with {others} others, but sees fewer than {bounds.least_points} points "
        "from which its pose could be refined"
    )


def refined_poses(
    model: Any,
    matched: MatchedPairs,
    given: Mapping[str, Float64Array],
    placed: Mapping[str, Float64Array],
) -> RefinedPoses:
    """What the refinement did.

    Args:
        model: pycolmap.Reconstruction, refined.
        matched: the photos' matches.
        given: ``cam_from_world``, (4, 4), by name, before.
        placed: the same of the photos in the model, after.
    """
    before = matched.errors({name: given[name] for name in placed})
    after = matched.errors(placed)
    moved = [camera_centre(given[name]) - camera_centre(pose) for name, pose in placed.items()]
    distances = np.linalg.norm(moved, axis=1)
    turned = [
        rotation_angle_degrees(given[name][:3, :3] @ pose[:3, :3].T)
        for name, pose in placed.items()
    ]
    return RefinedPoses(
        error_before=float(np.median(np.concatenate(before))),
        error_after=float(np.median(np.concatenate(after))),
        moved=float(np.median(distances)),
        moved_most=float(np.max(distances)),
        turned=float(np.median(turned)),
        groups=_groups(model),
    )


def _groups(model: Any) -> int:
    """Sets of photos that hang together by points."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    images = [image for image in model.images.values() if image.has_pose]
    seen = [np.array(sorted(set(image_points(image)))) for image in images]
    numbers, columns = np.unique(np.concatenate(seen), return_inverse=True)
    rows = np.repeat(np.arange(len(images)), [len(each) for each in seen])
    nodes = len(images) + len(numbers)
    graph = coo_matrix((np.ones(len(rows)), (rows, columns + len(images))), (nodes, nodes))
    return int(connected_components(graph, directed=False)[0])
