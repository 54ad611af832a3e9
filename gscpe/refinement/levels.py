# SPDX-License-Identifier: Apache-2.0
"""An anchor that is prepared once, and aligned with a photo level by level, small images first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Sequence

import numpy as np

from gscpe.arrays import Float64Array, short_repr
from gscpe.refinement.lucas_kanade import Alignment, align
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.template import Template, build_template
from gscpe.refinement.turned_starts import align_from_turned_starts


@dataclass(frozen=True, eq=False)
class PreparedAnchor:
    """All that an alignment needs of a render; good for any number of photos.

    Attributes:
        levels: of its pyramid, full size first.
        templates: one for each level; None where the mask left too few pixels.
        solvers: settings of the solver at each level.
    """

    levels: tuple[AnchorLevel, ...]
    templates: tuple[Template | None, ...]
    solvers: tuple[LucasKanadeSettings, ...]

    def __repr__(self) -> str:
        return short_repr(self)

    @classmethod
    def of(
        cls, levels: Sequence[AnchorLevel], solvers: Sequence[LucasKanadeSettings]
    ) -> PreparedAnchor:
        """Makes the templates."""
        templates = [
            build_template(level, solver) for level, solver in zip(levels, solvers, strict=True)
        ]
        return cls(tuple(levels), tuple(templates), tuple(solvers))

    def from_level(self, level: int) -> PreparedAnchor:
        """The same without its larger images."""
        return PreparedAnchor(self.levels[level:], self.templates[level:], self.solvers[level:])


@dataclass(frozen=True)
class TurnedStarts:
    """Whether the smallest image is aligned from turned cameras, too (``turned_starts.py``).

    Attributes:
        degrees: that they are turned by; 0: they are not.
        level: only where images are halved so many times, or more.
    """

    degrees: float
    level: int

    def at(self, level: int) -> bool:
        return level >= self.level and self.degrees > 0


def align_levels(
    anchor: PreparedAnchor,
    photo_levels: Sequence[ImageLevel],
    gain: float,
    bias: float,
    start_photo_from_anchor: Float64Array | None = None,
    turned: TurnedStarts | None = None,
    coarsest: int | None = None,
    iterated: Callable[[Float64Array], None] | None = None,
) -> tuple[Alignment, Template] | str:
    """Aligns an anchor with a photo; a string says why that failed.

    The template that is returned is that of the full size.

    Args:
        anchor: and ...
        photo_levels: ... the photo, of which no fewer levels are needed.
        gain, bias: start.
        start_photo_from_anchor: (4, 4); None: the photo was taken where the anchor was rendered.
        turned: starts in the smallest image.
        coarsest: level to begin with; None: the anchor's smallest.
        iterated: is told the pose after each iteration.
    """
    start = np.eye(4) if start_photo_from_anchor is None else start_photo_from_anchor
    last = len(anchor.levels) - 1
    alignment: Alignment | None = None
    template: Template | None = None
    for level in range(last if coarsest is None else min(coarsest, last), -1, -1):
        template, photo = anchor.templates[level], photo_levels[level]
        solver = anchor.solvers[level]
        if template is None:
            if level > 0:
                continue  # a small image may lose all its pixels to the mask
            return "too little of the map is visible around the pose that it starts from"
        if alignment is None and turned is not None and turned.at(level):
            found = align_from_turned_starts(
                *(template, anchor.levels[level], photo, gain, bias, turned.degrees),
                *(solver, iterated, start),
            )
        else:
            found = align(template, photo, start, gain, bias, solver, iterated)
        if found is None:
            if level > 0:
                continue  # it ran away; a larger image may hold it
            return "the photo and the map do not overlap around the pose that it starts from"
        alignment = found
        start, gain, bias = found.photo_from_anchor, found.gain, found.bias
    assert alignment is not None and template is not None
    return alignment, template
