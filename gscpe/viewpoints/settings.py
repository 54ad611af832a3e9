# SPDX-License-Identifier: Apache-2.0
"""Settings of the search for viewpoints."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from gscpe.errors import SettingsError
from gscpe.geometry.camera import Camera

_LEAST_SIDE = 48
"""Pixels: SIFT finds some thirty features in photos of 64x48 pixels, and five in 32x24."""


def _typical_camera() -> Camera:
    return Camera.pinhole(640, 480, fx=530.0, fy=530.0, cx=320.0, cy=240.0)


@dataclass(frozen=True)
class ViewpointSettings:
    """How viewpoints are looked for, and what makes a good one.

    Lengths are relative to the splat's own, so that its unit does not matter.

    Attributes:
        camera: of the views; pinhole. Photos are resized to its pixels per radian before they are
            localized, so it is best that of the photos that the splat was trained on.
        up: the direction that is up in the splat's frame; None: found in the splat.
        most: views at most, the best ones.
        spacing: between neighbouring viewpoints, relative to the least extent of the splat's core.
        clearance: to the next surface at least, relative to the spacing.
        seeds: places that are tried first, spread over the free space.
        grown: places beside good ones that are tried after that, ...
        between: ... and at last, in steps half as long, between the good ones.
        margin: in scores (natural logarithms) by which a view may be worse than the fifth best.
        yaw_step: degrees between views at one place.
        pitch_down: degrees by which views look below the horizon; None: as far as the splat looks
            best, which is how its photos mostly looked.
        min_covered: share of a view that must show the splat.
        max_thickness: standard deviation of depth along a ray relative to depth (median of a
            view), above which a view shows haze and no surface.

    Raises:
        SettingsError: a value is out of its range, or the camera has a distorted lens.
    """

    camera: Camera = field(default_factory=_typical_camera)
    up: tuple[float, float, float] | None = None
    most: int = 300
    spacing: float = 0.25
    clearance: float = 0.4
    seeds: int = 32
    grown: int = 96
    between: int = 96
    margin: float = 2.2
    yaw_step: float = 30.0
    pitch_down: float | None = None
    min_covered: float = 0.6
    max_thickness: float = 0.45

    def __post_init__(self) -> None:
        if min(self.most, self.seeds) < 1 or min(self.grown, self.between) < 0:
            raise SettingsError("viewpoints need most and seeds >= 1, grown and between >= 0")
        if not (0 < self.spacing < inf and 0 < self.clearance < inf and 0 < self.yaw_step <= 90):
            raise SettingsError(
                "viewpoints need a positive spacing and clearance, and a yaw_step in (0, 90]"
            )
        if not (0 <= self.margin < inf and -90 < (self.pitch_down or 0.0) < 90):
            raise SettingsError("viewpoints need margin >= 0, and a pitch_down between -90 and 90")
        if not (0 <= self.min_covered <= 1 and self.max_thickness > 0):
            raise SettingsError("min_covered is a share in [0, 1], max_thickness is positive")
        if min(self.camera.width, self.camera.height) < _LEAST_SIDE:
            raise SettingsError(
                f"views of {self.camera.width}x{self.camera.height} pixels are too small to "
                f"recognize places by; the camera needs {_LEAST_SIDE} pixels each way"
            )
        if not self.camera.is_pinhole:
            raise SettingsError("views are rendered: their camera must be a pinhole")
        if self.up is not None and not (
            len(self.up) == 3 and 1e-6 < sum(x * x for x in self.up) < inf
        ):
            raise SettingsError(f"up must be a direction of three numbers, not {self.up}")
