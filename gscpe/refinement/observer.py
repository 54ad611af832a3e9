# SPDX-License-Identifier: Apache-2.0
"""Looks on while a pose is refined: for tools that measure, and for pictures of the way."""

from __future__ import annotations

from gscpe.arrays import BoolArray, Float64Array
from gscpe.refinement.lucas_kanade import Alignment
from gscpe.render import RenderedView


class RefinementObserver:
    """Its methods are called at each step of :func:`gscpe.refinement.refine_pose`. Override the
    methods that you need; do not change their arguments."""

    def anchor_rendered(self, view: RenderedView) -> None:
        """A render that will serve as the template."""

    def mask_made(self, mask: BoolArray) -> None:
        """The visibility mask, (H, W), of the last anchor."""

    def iterated(self, photo_from_anchor: Float64Array) -> None:
        """A step of the solver, at any pyramid level, came to this pose, (4, 4)."""

    def anchor_aligned(self, alignment: Alignment) -> None:
        """The result of the last anchor."""
