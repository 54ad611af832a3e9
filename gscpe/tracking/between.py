# SPDX-License-Identifier: Apache-2.0
"""A frame between two anchors is aligned with both, and its pose is their mean.

Where a render's depth is off, the picture is shifted in proportion to how far the camera moved
from there: forward from one anchor, backward from the other. So the mean is better than either,
most of all where both are far.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.geometry import se3
from gscpe.refinement.lucas_kanade import align
from gscpe.tracking.anchors import Anchor
from gscpe.tracking.follow import Followed
from gscpe.tracking.frames import Frame
from gscpe.tracking.settings import TrackingSettings

_NEAR = 0.75
"""Times ``anchor_pixels`` from an anchor within which another has nothing to add."""
_FARTHER = 4.0
"""Times farther than the nearest anchor at which another has nothing to add."""
_ELSEWHERE = 1.0
"""Pixels by which the two may differ."""


def aligned_between(
    followed: Followed, frame: Frame, anchors: list[Anchor], settings: TrackingSettings
) -> Followed:
    """The frame aligned with another anchor too, if there is one that adds something.

    Args:
        followed: as it was aligned with the nearest anchor.
        frame: the frame.
        anchors: all that there are.
        settings: of the tracker.
    """
    pose = followed.cam_from_world
    distance = followed.anchor.pixels_to(pose)
    if distance <= _NEAR * settings.anchor_pixels:
        return followed
    others = [
        (anchor.pixels_to(pose), anchor) for anchor in anchors if anchor is not followed.anchor
    ]
    if not others:
        return followed
    farther, other = min(others, key=lambda pair: pair[0])
    if farther > min(settings.farthest_pixels, _FARTHER * distance):
        return followed
    alignment = align(
        other.judged,
        frame.levels[0],
        pose @ se3.inverse(other.cam_from_world),
        followed.alignment.gain,
        followed.alignment.bias,
        other.prepared.solvers[0],
    )
    if alignment is None or not alignment.converged:
        return followed
    step = se3.log(alignment.photo_from_anchor @ other.cam_from_world @ se3.inverse(pose))
    if np.sqrt(step @ followed.anchor.template.motion @ step) > _ELSEWHERE:
        return followed
    weight = distance**2 / (distance**2 + farther**2)
    return replace(followed, cam_from_world=se3.nearest_rigid(se3.exp(weight * step) @ pose))
