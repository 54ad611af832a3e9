# SPDX-License-Identifier: Apache-2.0
"""A second pose that many of the matches agree on, and that contradicts the first.

Matches that are wrong by chance agree on nothing. Where much of the rest agrees on another pose,
a part of what the photo shows has been moved, as a whole, since the map was made; and the larger
number of matches may well be on that part. What stayed is spread over more of the photo.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.coarse.least_squares import Matches2D3D
from gscpe.coarse.pnp import AbsolutePose, PnPSettings, estimate_absolute_pose, pose_of_inliers
from gscpe.geometry.camera import Camera
from gscpe.geometry.spread import spread_over_image
from gscpe.ranges import check_numbers, check_shares, check_whole


@dataclass(frozen=True)
class RivalSettings:
    """When a second pose counts (set on ten photos with moved furniture: docs/benchmarks.md).

    Attributes:
        min_inliers: matches that the first must have: fewer may be chance, of which more may be
            left.
        min_share: of these, so many must agree with the second.
        min_pixels: by which one of them has what the other explains elsewhere (median): nearer ones
            are the same pose, in a map that is a little bent.

    Raises:
        SettingsError: a value is out of its range.
    """

    min_inliers: int = 100
    min_share: float = 0.3
    min_pixels: float = 8.0

    def __post_init__(self) -> None:
        check_whole(self, "min_inliers", least=0)
        check_shares(self, "min_share")
        check_numbers(self, "min_pixels", least=0)


def find_rival(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    prior_cam_from_world: Float64Array,
    first: AbsolutePose,
    pnp: PnPSettings,
    settings: RivalSettings,
) -> AbsolutePose | None:
    """The pose that most of the matches agree on which do not agree with the first; None where
    these are few, or it does not contradict the first.

    Args:
        points_world, pixels: (N, 3) and (N, 2), all matches.
        camera: pinhole camera of the pixels.
        prior_cam_from_world: (4, 4), the pose before.
        first: of the matches.
        pnp, settings: of the estimate, and what counts.
    """
    count, left = int(first.inliers.sum()), np.flatnonzero(~first.inliers)
    least = settings.min_share * count
    if count < settings.min_inliers or len(left) < least:
        return None
    found = estimate_absolute_pose(
        points_world[left], pixels[left], camera, prior_cam_from_world, pnp
    )
    if found is None or found.inliers.sum() < least:
        return None
    theirs = left[found.inliers]
    # What is far away moves little when the camera does: so each is asked for what the other has.
    apart = max(
        _misses(points_world[its], pixels[its], camera, other.cam_from_world, pnp)
        for its, other in ((theirs, first), (np.flatnonzero(first.inliers), found))
    )
    if apart < settings.min_pixels:
        return None
    inliers = np.zeros(len(pixels), dtype=bool)
    inliers[theirs] = True
    return replace(found, inliers=inliers)


def _misses(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    pnp: PnPSettings,
) -> float:
    """Median of the pixels by which a pose has matches beside where they are."""
    seen = Matches2D3D(points_world, pixels, camera, pnp.cells).projected(cam_from_world)
    return float(np.sqrt(np.median(seen.squared)))


def better_spread(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    first: AbsolutePose,
    rival: AbsolutePose,
    pnp: PnPSettings,
) -> tuple[AbsolutePose, AbsolutePose]:
    """Both, that of what stayed before that of what has been moved: first the one whose matches are
    spread over more of the photo. Arguments as :func:`find_rival`."""
    of_first, of_rival = (
        spread_over_image(pixels[pose.inliers], camera) for pose in (first, rival)
    )
    if of_rival <= of_first:
        return first, rival
    whole = pose_of_inliers(points_world, pixels, camera, rival.cam_from_world, pnp)
    if whole is None:
        return first, rival
    return whole, replace(first, inliers=first.inliers & ~whole.inliers)
