# SPDX-License-Identifier: Apache-2.0
"""Settings of the search for viewpoints."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from numbers import Real
from types import NoneType

from gscpe.errors import SettingsError
from gscpe.geometry.camera import Camera
from gscpe.ranges import check_kinds, check_numbers, check_shares, check_whole

_LEAST_SIDE = 48
"""Pixels: SIFT finds some thirty features in photos of 64x48 pixels, and five in 32x24."""


def _is_direction(up: tuple[float, float, float]) -> bool:
    return (
        len(up) == 3
        and all(isinstance(number, Real) for number in up)
        and 1e-6 < sum(number * number for number in up) < inf
    )


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
        check_kinds(self, camera=Camera, up=(tuple, NoneType))
        check_whole(self, "most", "seeds", least=1)
        check_whole(self, "grown", "between", least=0)
        check_numbers(self, "spacing", "clearance", above=0)
        check_numbers(self, "max_thickness", above=0, infinite=True)
        check_numbers(self, "margin", least=0)
        check_numbers(self, "yaw_step", above=0, most=90)
        check_numbers(self, "pitch_down", above=-90, below=90, optional=True)
        check_shares(self, "min_covered")
        if min(self.camera.width, self.camera.height) < _LEAST_SIDE:
            raise SettingsError(
                f"views of {self.camera.width}x{self.camera.height} pixels are too small to "
                f"recognize places by; the camera needs {_LEAST_SIDE} pixels each way"
            )
        if not self.camera.is_pinhole:
            raise SettingsError("views are rendered: their camera must be a pinhole")
        if self.up is not None and not _is_direction(self.up):
            raise SettingsError(f"up must be a direction of three numbers, not {self.up}")
