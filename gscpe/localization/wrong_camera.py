# SPDX-License-Identifier: Apache-2.0
"""Whether matches contradict the camera that was given, and in what."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.coarse import CoarseResult
from gscpe.geometry.camera import Camera
from gscpe.geometry.intrinsics import ASPECT, FOCAL, PRINCIPAL_X, PRINCIPAL_Y, RADIAL
from gscpe.ranges import check_numbers

_ALL = (FOCAL, ASPECT, PRINCIPAL_X, PRINCIPAL_Y, RADIAL)
_ENOUGH = 0.8
"""Share of what a wrong camera explains that a wrong focal length alone must explain, which matches
tell best, for it to be what is wrong."""


@dataclass(frozen=True)
class CameraCheckSettings:
    """When a given camera contradicts the matches (measured: docs/benchmarks.md).

    Attributes:
        max_focal_error: largest difference, beyond chance, between the camera's focal length and
            the one that fits the matches, as a share; more: the camera is wrong. A smaller
            difference goes into the covariance; so it is for the others.
        max_aspect_error: ... between fy / fx and the one that fits, as a share.
        max_principal_error: ... in either coordinate of the principal point, as a share of the
            focal length.
        max_radial_error: ... in k1.
        tolerance: standard deviation that any of these may be off by because the map is bent; of
            k1, twice as much.
        chance: squared deviations, beside one for each number sought, that are due to chance.

    Raises:
        SettingsError: a value is out of its range.
    """

    max_focal_error: float = 0.03
    max_aspect_error: float = 0.015
    max_principal_error: float = 0.015
    max_radial_error: float = 0.03
    tolerance: float = 0.003
    chance: float = 3.0

    def __post_init__(self) -> None:
        limits = "max_focal_error", "max_aspect_error", "max_principal_error", "max_radial_error"
        check_numbers(self, *limits, above=0, infinite=True)
        check_numbers(self, "tolerance", "chance", least=0)

    @property
    def limits(self) -> Float64Array:
        """(5,), of each number of ``Camera.covariance``."""
        principal = self.max_principal_error
        focal, aspect, radial = self.max_focal_error, self.max_aspect_error, self.max_radial_error
        return np.array([focal, aspect, principal, principal, radial])


@dataclass(frozen=True, eq=False)
class Contradiction:
    """How the camera must change to fit the matches, beyond chance.

    Attributes:
        change: (5,), of the numbers of ``Camera.covariance``, less what chance explains.
        covariance: (5, 5), what it makes the camera unsure by: the whole change, and how badly it
            is known, as far as chance does not explain it; where it does, what matches ask of the
            focal length alone beyond their own scatter.
    """

    change: Float64Array
    covariance: Float64Array


def contradiction(
    coarse: CoarseResult, camera: Camera, settings: CameraCheckSettings
) -> Contradiction:
    """What matches have against the camera; nothing where chance explains it."""
    found = coarse.intrinsics
    change, covariance = np.zeros(5), np.zeros((5, 5))
    if found is None:
        return Contradiction(change, covariance)
    information = np.linalg.inv(found.covariance)
    pull = information @ found.change
    by_focal = pull[FOCAL] ** 2 / information[FOCAL, FOCAL]
    numbers = [FOCAL] if by_focal > _ENOUGH * (pull @ found.change) else list(_ALL)
    its = np.ix_(numbers, numbers)
    known = np.linalg.inv(information[its])
    asked = known @ pull[numbers]
    bent = settings.tolerance**2 * np.diag([1.0, 1.0, 1.0, 1.0, 4.0])
    off = known + (bent + camera.covariance_matrix())[its]
    squared, chance = asked @ np.linalg.solve(off, asked), settings.chance + len(numbers)
    if squared > chance:
        share = 1.0 - chance / squared
        change[numbers] = np.sqrt(share) * asked
        covariance[its] = share * (np.outer(asked, asked) + known)
    else:  # not wrong, but a focal length that is off by half a per cent moves the pose by sigmas
        of_focal = pull[FOCAL] / information[FOCAL, FOCAL]
        scatter = 1.0 / information[FOCAL, FOCAL] + camera.focal_sigma**2
        covariance[FOCAL, FOCAL] = max(of_focal**2 - scatter, 0.0)
    return Contradiction(change, covariance)


def excess(coarse: CoarseResult, camera: Camera, settings: CameraCheckSettings) -> float:
    """The largest change that matches ask for, as a multiple of the limit; above 1: the camera is
    wrong."""
    return float(np.max(np.abs(contradiction(coarse, camera, settings).change) / settings.limits))


def doubt_about_camera(
    coarse: CoarseResult, camera: Camera, settings: CameraCheckSettings
) -> str | None:
    """Why the camera cannot be trusted, and what to do; or None."""
    found = contradiction(coarse, camera, settings)
    beyond = np.abs(found.change) / settings.limits
    worst = int(np.argmax(beyond))
    if coarse.intrinsics is None or not beyond[worst] > 1.0:
        return None
    asked = coarse.intrinsics.change
    if worst == RADIAL:
        return (
            f"the matches ask for k1 = {asked[RADIAL]:.2g} beyond the camera's distortion: declare "
            "the distortion, or undistort the photo"
        )
    if worst == FOCAL:
        ratio = float(np.exp(found.change[FOCAL]))
        what = f"the matches fit {ratio:.3g} times the camera's focal length"
    elif worst == ASPECT:
        ratio = camera.fy / camera.fx
        what = (
            f"the matches fit fy = {ratio * np.exp(asked[ASPECT]):.3g} fx, not the camera's "
            f"{ratio:.3g} fx"
        )
    else:
        aside = float(np.hypot(asked[PRINCIPAL_X], asked[PRINCIPAL_Y]))
        what = (
            f"the matches fit a principal point that is {aside:.1%} of the focal length away from "
            "the camera's"
        )
    return f"{what}: give the correct intrinsics, or none to have them estimated"
