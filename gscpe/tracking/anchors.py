# SPDX-License-Identifier: Apache-2.0
"""Renders that frames are aligned with, prepared for that once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gscpe.arrays import Float64Array, IntArray, short_repr
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.photos import luminance
from gscpe.refinement.levels import PreparedAnchor
from gscpe.refinement.pyramid import anchor_pyramid
from gscpe.refinement.template import Template, motion_of
from gscpe.refinement.uncertainty import blocks_of
from gscpe.refinement.visibility import visibility_mask
from gscpe.render import Renders
from gscpe.tracking.frames import most_levels
from gscpe.tracking.settings import TrackingSettings

_LENIENT = 3
"""Halvings from which half of the pixels that a pixel is made of must be valid, not all."""
_COARSELY = 0.1
"""Pixels of a smaller image to which it is aligned: a larger one follows."""
_BLOCKS = 10
"""Blocks across the picture in which anchor and frame are compared."""


@dataclass(frozen=True, eq=False)
class Anchor:
    """A render, ready to be aligned with any number of frames.

    Attributes:
        cam_from_world: (4, 4), where it was rendered.
        prepared: its pyramid and templates.
        judged: pixels of the largest image by which the covariance is estimated.
        compared: level at which it is compared with frames.
        blocks: (N,) block of each pixel of that level's template.
        asked: number of the frame after which it was asked for.
        tolerance_unit: metres per world unit, for tolerances; see
            :meth:`gscpe.RenderedView.tolerance_unit`.
    """

    cam_from_world: Float64Array
    prepared: PreparedAnchor
    judged: Template
    compared: int
    blocks: IntArray
    asked: int
    tolerance_unit: float

    def __repr__(self) -> str:
        return short_repr(self)

    @property
    def template(self) -> Template:
        """Of the largest image."""
        template = self.prepared.templates[0]
        assert template is not None
        return template

    def pixels_to(self, cam_from_world: Float64Array) -> float:
        """How far the image has moved from this anchor, at another pose: root mean square, pixels
        of the largest image."""
        return motion_of(self.template, cam_from_world @ se3.inverse(self.cam_from_world))

    def smaller(self, halvings: int) -> Anchor | None:
        """The anchor for frames without their largest images; None where nothing would be left."""
        prepared = self.prepared.from_level(halvings)
        if not prepared.levels or prepared.templates[0] is None:
            return None
        blocks = blocks_of(prepared.templates[0], prepared.levels[0].camera, _BLOCKS)
        return replace(self, prepared=prepared, compared=0, blocks=blocks)


def make_anchor(
    renders: Renders,
    camera: Camera,
    cam_from_world: Float64Array,
    settings: TrackingSettings,
    metres_per_unit: float,
    asked: int,
) -> Anchor | None:
    """Renders an anchor and prepares it; None where too little of the map is visible.

    Args:
        renders: the map.
        camera: of the frames.
        cam_from_world: (4, 4).
        settings: of the tracker.
        metres_per_unit: of the world.
        asked: number of the frame after which it was asked for.
    """
    view = renders.render(camera, cam_from_world)
    unit = view.tolerance_unit(metres_per_unit)
    mask = visibility_mask(renders, view, settings.visibility, unit)
    levels = most_levels(camera, settings.levels)
    pyramid = anchor_pyramid(luminance(view.rgb), view.depth, mask, camera, levels, _LENIENT)
    fine = replace(settings.solver, max_template_pixels=settings.template_pixels)
    coarse = replace(
        settings.solver,
        max_template_pixels=settings.coarse_pixels,
        converged_pixels=max(_COARSELY, settings.solver.converged_pixels),
    )
    prepared = PreparedAnchor.of(pyramid, [fine, *(levels * [coarse])])
    if prepared.templates[0] is None:
        return None
    compared = 1 if levels >= 1 and prepared.templates[1] is not None else 0
    template = prepared.templates[compared]
    assert template is not None
    return Anchor(
        cam_from_world=np.array(cam_from_world, dtype=np.float64),
        prepared=prepared,
        judged=prepared.templates[0].thinned(settings.judged_pixels),
        compared=compared,
        blocks=blocks_of(template, pyramid[compared].camera, _BLOCKS),
        asked=asked,
        tolerance_unit=unit,
    )


def nearest(anchors: list[Anchor], cam_from_world: Float64Array) -> tuple[Anchor, float]:
    """The anchor from which the image has moved least, and how far; there is at least one."""
    distances = [anchor.pixels_to(cam_from_world) for anchor in anchors]
    best = int(np.argmin(distances))
    return anchors[best], distances[best]
