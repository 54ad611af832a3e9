# SPDX-License-Identifier: Apache-2.0
"""Whether a splat was ever seen from a place: how much a render looks as its photos did."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.photos import luminance
from gscpe.render import RenderedView
from gscpe.viewpoints.lattice import lattice_spacing
from gscpe.viewpoints.settings import ViewpointSettings
from gscpe.viewpoints.space import Space

_SEEN = 0.5
_BLUR = 1.5
_SHARP, _THIN = 0.002, 0.02
"""Added to sharpness and thickness, so that a blank wall and a perfect one have a finite score."""


@dataclass(frozen=True)
class ViewQuality:
    """What a small render shows.

    Attributes:
        covered: share of the picture that shows the splat.
        depth: median depth of that, scene units; 0 where nothing is seen.
        near: a twentieth of what is seen is nearer than this, scene units.
        sharpness: mean absolute difference of brightness to a blurred picture, in [0, 1].
        thickness: median standard deviation of depth along a ray, relative to depth.
    """

    covered: float
    depth: float
    near: float
    sharpness: float
    thickness: float

    @property
    def score(self) -> float:
        """High where surfaces are sharp and thin.

        Training makes them so for the places that photos were taken from, and only there: seen
        from behind or from aside, Gaussians that nobody looked at stand before them. On
        RedKitchen, the scores of its photos' poses lie between -0.9 and 0.4, those of views from
        behind between -5 and -1.4.
        """
        return float(np.log(self.sharpness + _SHARP) - np.log(self.thickness + _THIN))


def view_quality(view: RenderedView) -> ViewQuality:
    """Of a render, a hundred pixels wide or so."""
    seen = (view.opacity > _SEEN) & (view.depth > 0)
    if not np.any(seen):
        return ViewQuality(0.0, 0.0, 0.0, 0.0, 1.0)
    depth = view.depth[seen]
    deviation = np.sqrt(np.maximum(view.depth_variance[seen], 0.0)) / depth
    grey = np.clip(luminance(view.rgb), 0.0, 1.0)
    detail = np.abs(grey - cv2.GaussianBlur(grey, (0, 0), _BLUR))
    return ViewQuality(
        covered=float(seen.mean()),
        depth=float(np.median(depth)),
        near=float(np.quantile(depth, 0.05)),
        sharpness=float(detail[seen].mean()),
        thickness=float(np.median(deviation)),
    )


def is_usable(quality: ViewQuality, space: Space, settings: ViewpointSettings) -> bool:
    """Whether a view shows enough, nothing too near, and surfaces rather than haze."""
    return (
        quality.covered >= settings.min_covered
        and quality.near >= 0.5 * settings.clearance * lattice_spacing(space, settings)
        and quality.thickness <= settings.max_thickness
    )


def distance_penalty(depth: float, space: Space) -> float:
    """What is subtracted from a view's score: from afar, everything looks sharp."""
    return max(0.0, float(np.log(depth / (0.5 * space.breadth))))
