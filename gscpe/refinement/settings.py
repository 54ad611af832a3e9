# SPDX-License-Identifier: Apache-2.0
"""Settings of the refinement."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from gscpe.errors import SettingsError
from gscpe.ranges import check_kinds, check_numbers, check_whole
from gscpe.refinement.light import LightSettings
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.uncertainty import UncertaintySettings
from gscpe.refinement.visibility import VisibilitySettings

_COARSELY = 0.04
"""Pixels of a smaller image within which its alignment is good enough to go on from."""


@dataclass(frozen=True)
class RefinementSettings:
    """Settings of the refinement; the defaults are the paper's where it gives one.

    Attributes:
        levels: S, times the image is halved (fewer where it would become tiny).
        smallest_side: pixels of the shorter side below which an image is not halved.
        lenient_level: halvings from which half of the pixels that a pixel is made of must be
            valid, not all: otherwise little would be left of a cluttered scene.
        agreement_level: halvings at which photo and render are compared in the end, always the
            same: small images look alike more easily.
        turned_degrees: where images are halved ``turned_level`` times or more, the smallest is
            aligned from cameras turned by so many degrees, too; 0: not.
        turned_level: see above.
        light: of photos that are overexposed, or lit unevenly.
        max_anchors: renders that serve as templates, at most.
        min_anchors: ... at least; the later ones see the scene from the aligned pose.
        rerender_pixels: the scene is rendered anew when the image has moved more than this
            since the anchor, root mean square: what the anchor shows of it, and how its
            splats overlap, depends on that.
        far_pixels: ... and when it has moved more than this, all levels are run again.
        rerender_translation: the paper's criterion instead, where given: metres since the
            anchor beyond which it is rendered anew, ...
        rerender_rotation_degrees: ... or degrees (either is enough: the paper's Algorithm 2
            says both, its text either).
        visibility: the mask.
        solver: at full size.
        coarse_pixels: templates of smaller images are thinned to about so many, and their levels
            end sooner: only a start is wanted from them.
        rolling_pixels: how far the rows of a photo disagree, since they were not exposed at once
            or the map is bent: standard deviation, from the first row to the last, of a motion of
            the picture (root mean square); 0: one pose fits them all. See ``rolling.py``.
        uncertainty: of the covariance.
    """

    levels: int = 2
    smallest_side: int = 16
    lenient_level: int = 3
    agreement_level: int = 1
    turned_degrees: float = 5.0
    turned_level: int = 4
    light: LightSettings = field(default_factory=LightSettings)
    max_anchors: int = 5
    min_anchors: int = 1
    rerender_pixels: float = 1.0
    far_pixels: float = 8.0
    rerender_translation: float | None = None
    rerender_rotation_degrees: float | None = None
    visibility: VisibilitySettings = field(default_factory=VisibilitySettings)
    solver: LucasKanadeSettings = field(default_factory=LucasKanadeSettings)
    coarse_pixels: int = 20_000
    rolling_pixels: float = 1.0
    uncertainty: UncertaintySettings = field(default_factory=UncertaintySettings)

    def __post_init__(self) -> None:
        check_whole(self, "levels", "lenient_level", "agreement_level", "turned_level", least=0)
        check_whole(self, "smallest_side", "coarse_pixels", "max_anchors", "min_anchors", least=1)
        check_numbers(
            self, "turned_degrees", "rerender_pixels", "far_pixels", "rolling_pixels", least=0
        )
        check_numbers(
            self, "rerender_translation", "rerender_rotation_degrees", least=0, optional=True
        )
        check_kinds(
            self,
            light=LightSettings,
            visibility=VisibilitySettings,
            solver=LucasKanadeSettings,
            uncertainty=UncertaintySettings,
        )
        if self.min_anchors > self.max_anchors:
            raise SettingsError(
                f"refinement needs min_anchors <= max_anchors, not {self.min_anchors} and "
                f"{self.max_anchors}"
            )

    def coarse_solver(self) -> LucasKanadeSettings:
        """Of the smaller images."""
        solver = self.solver
        return replace(
            solver,
            max_template_pixels=min(solver.max_template_pixels, self.coarse_pixels),
            converged_pixels=max(solver.converged_pixels, _COARSELY),
            extrapolate=True,
        )
