# SPDX-License-Identifier: Apache-2.0
"""Tries turned cameras on the smallest image, where an alignment costs next to nothing.

A camera that is turned by a few degrees moves the picture by more than the smallest image's
features are wide: Lucas-Kanade then ends in a wrong place, often far away. One of a few turned
starts is near enough, and photo and render look alike only in the right place.
"""

from __future__ import annotations

from typing import Callable

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry import se3
from gscpe.refinement.agreement import photometric_agreement
from gscpe.refinement.lucas_kanade import Alignment, align
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.template import Template

_LEAST_OVERLAP = 0.3
"""What overlaps less may look alike by chance."""

_ROLL = 1.6
"""About the viewing axis, the same angle moves the picture less."""


def align_from_turned_starts(
    template: Template,
    anchor: AnchorLevel,
    photo: ImageLevel,
    gain: float,
    bias: float,
    degrees: float,
    settings: LucasKanadeSettings,
    iterated: Callable[[Float64Array], None] | None = None,
    photo_from_anchor: Float64Array | None = None,
) -> Alignment | None:
    """The alignment that looks most alike, of seven: not turned, and turned by so many degrees
    about each axis, either way. None when none of them held.

    Args:
        template, anchor, photo: of one level.
        gain, bias: start.
        degrees: that the camera is turned by, left, right, up and down; and 1.6 times so many
            about its axis.
        settings: of the solver.
        iterated: is told the pose after each iteration.
        photo_from_anchor: (4, 4), the start that is not turned; None: the identity.
    """
    best: tuple[float, Alignment] | None = None
    unturned = np.eye(4) if photo_from_anchor is None else photo_from_anchor
    for turn in _turns(degrees):
        start = turn @ unturned
        found = align(template, photo, start, gain, bias, settings, iterated)
        if found is None:
            continue
        agreement, overlap = photometric_agreement(anchor, photo, found.photo_from_anchor)
        likeness = agreement if overlap >= _LEAST_OVERLAP and np.isfinite(agreement) else -1.0
        if best is None or likeness > best[0]:
            best = likeness, found
    return None if best is None else best[1]


def _turns(degrees: float) -> list[Float64Array]:
    steps = np.radians(degrees) * np.diag([1.0, 1.0, _ROLL])
    both = [sign * step for step in steps for sign in (-1.0, 1.0)]
    return [np.eye(4), *(se3.exp(np.concatenate([np.zeros(3), turn])) for turn in both)]
