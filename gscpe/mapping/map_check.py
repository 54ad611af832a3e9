# SPDX-License-Identifier: Apache-2.0
"""The strongest check of a finished map: its own reference photos are localized in it, and must
come back to their own poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array
from gscpe.errors import MapError
from gscpe.geometry.pose_error import pose_difference
from gscpe.geometry.se3 import inverse, log
from gscpe.geometry.spread import evenly_spread
from gscpe.localization import LocalizationResult, Localizer
from gscpe.mapping.reference_photos import reference_image
from gscpe.mapping.settings import MapCheckSettings
from gscpe.matching import Matcher
from gscpe.scene import Map, MapFrame


@dataclass(frozen=True)
class CheckedReference:
    """What came of localizing a reference photo.

    Attributes:
        name: of the photo.
        returned: whether it came back to its own pose.
        distance, degrees: how far it is from there, in the world's unit; NaN where it was not
            localized.
        sigmas: the same in standard deviations of the result.
        reason: why it was not localized; None where it was.
    """

    name: str
    returned: bool
    distance: float
    degrees: float
    sigmas: float
    reason: str | None


@dataclass(frozen=True)
class MapCheck:
    """Whether a map's references come back to their own poses.

    Attributes:
        references: those that were localized.
        good: whether the map is; see :class:`MapCheckSettings`.
        frame: of the map, which knows the unit.
    """

    references: tuple[CheckedReference, ...]
    good: bool
    frame: MapFrame

    def __str__(self) -> str:
        count = len(self.references)
        found = [each for each in self.references if each.reason is None]
        returned = sum(each.returned for each in found)
        text = f"{returned} of {count} reference photos come back to their own poses"
        if found:
            distances = [each.distance for each in found]
            median = self.frame.length_text(float(np.median(distances)) * self.frame.scale)
            degrees = float(np.median([each.degrees for each in found]))
            text += f" (median {median} and {degrees:.2f} degrees away)"
        away = [each for each in found if not each.returned]
        if away:
            worst = max(away, key=lambda each: each.sigmas)
            length = self.frame.length_text(worst.distance * self.frame.scale)
            text += (
                f"; {len(away)} are localized elsewhere, for example {worst.name}: {length} and "
                f"{worst.degrees:.2f} degrees away, {worst.sigmas:.0f} of its standard deviations"
            )
        lost = [each for each in self.references if each.reason is not None]
        if lost:
            text += f"; {len(lost)} are not localized, for example {lost[0].name}: {lost[0].reason}"
        return text


def check_map(
    map_: Map,
    image_folder: str | Path,
    settings: MapCheckSettings | None = None,
    backend: str = "auto",
    matcher: Matcher | str | None = None,
    *,
    progress: bool = False,
) -> MapCheck:
    """Localizes some of a map's references in it, as if nothing were known of them.

    Misfits of splat and poses, wrong units, and what compressing lost all show. Open the map from
    its folder first, so that what was written is what is checked.

    Args:
        map_: with references.
        image_folder: of their photos.
        settings: how many, and how near they must come back.
        backend, matcher: as :class:`gscpe.Localizer`.
        progress: show a bar.

    Raises:
        MapError: the map has no references, or they are virtual.
        PhotoError, CameraError: a photo cannot be used.
    """
    settings = settings or MapCheckSettings()
    references = map_.world_references
    if not len(references):
        raise MapError("a map without reference photos cannot be checked by them")
    if references.virtual:
        raise MapError("the map's references are renders of its splat: no photos can check it")
    chosen = evenly_spread(len(references), settings.references)
    checked = []
    with Localizer(map_, matcher=matcher, backend=backend, progress=progress) as localizer:
        for index in tqdm(chosen, desc="checking the map", unit="photo", disable=not progress):
            image = reference_image(references, index, image_folder)
            result = localizer.localize(image, references.cameras[index])
            pose = references.cam_from_world[index]
            checked.append(_checked(references.names[index], result, pose, map_.frame, settings))
    localized = sum(each.reason is None for each in checked)
    returned = sum(each.returned for each in checked)
    good = localized >= max(1.0, settings.min_localized * len(checked)) and (
        returned >= settings.min_returned * localized
    )
    return MapCheck(tuple(checked), good, map_.frame)


def _checked(
    name: str,
    result: LocalizationResult,
    cam_from_world: Float64Array,
    frame: MapFrame,
    settings: MapCheckSettings,
) -> CheckedReference:
    nan = float("nan")
    if result.cam_from_world is None or result.covariance is None or result.aligned is None:
        return CheckedReference(name, False, nan, nan, nan, result.reason)
    off = pose_difference(result.cam_from_world, cam_from_world)
    xi = log(cam_from_world @ inverse(result.cam_from_world))
    sigmas = float(np.sqrt(np.maximum(xi @ np.linalg.solve(result.covariance, xi), 0.0)))
    metres = off.distance * frame.scale * result.aligned.tolerance_unit
    near = metres <= settings.max_shift and off.degrees <= settings.max_degrees
    # The square of the sigmas has six degrees of freedom, so that 6 is what it is on average.
    returned = near or sigmas <= np.sqrt(6.0) * settings.max_sigmas
    return CheckedReference(name, bool(returned), off.distance, off.degrees, sigmas, None)
