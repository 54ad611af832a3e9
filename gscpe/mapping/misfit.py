# SPDX-License-Identifier: Apache-2.0
"""The misfit of a splat and its reference poses, measured: where the cameras really are in the
splat, and the similarity that takes the poses there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array
from gscpe.geometry.pose_error import pose_difference
from gscpe.geometry.similarity_transform import Similarity, fit_similarity_of_poses
from gscpe.geometry.spread import evenly_spread
from gscpe.localization import Localizer, PosePrior
from gscpe.mapping.reference_photos import at_most, reference_image
from gscpe.mapping.settings import FrameCheckSettings
from gscpe.matching import Matcher
from gscpe.scene import GlobalDescriptors, Map, MapFrame, References
from gscpe.scene.map_frame import TYPICAL_DEPTH, typical_depth
from gscpe.splats import GaussianScene

Verdict = Literal["fits", "a little off", "off"]

_HOPELESS = 6
"""References that are tried before the others are given up, where none is found."""

_SIGMA, _SIGMA_DEGREES = 0.1, 4.0
"""Of the priors, metres and degrees: aligned at once; matches are made where that fails."""


@dataclass(frozen=True, eq=False)
class Misfit:
    """How a splat lies with respect to the model of its reference poses.

    Attributes:
        splat_from_model: takes the model's frame to the splat's.
        scale_sigma: standard deviation of its scale, relative; infinite where the cameras
            stand too near together to tell, and the scale was held at 1.
        shift_sigma: of the shift, in the world's unit, and ...
        sigma_degrees: ... of the angle.
        shift: root mean square distance of where the cameras are in the splat from where the
            model says, in the world's unit.
        degrees: angle of the rotation.
        remaining: root mean square distance that the similarity does not explain, and ...
        remaining_degrees: ... angle.
        measured: references that were found in the splat.
        tried: references that were looked for.
        room_metres: metres a unit of the world for limits that are made for rooms.
        frame: of the map, which knows the unit.
    """

    splat_from_model: Similarity
    scale_sigma: float
    shift_sigma: float
    sigma_degrees: float
    shift: float
    degrees: float
    remaining: float
    remaining_degrees: float
    measured: int
    tried: int
    room_metres: float
    frame: MapFrame

    def verdict(self, settings: FrameCheckSettings) -> Verdict:
        """Whether it is small enough."""

        def certain(value: float, sigma: float) -> float:
            return value if value > settings.sure * sigma else 0.0

        metres = certain(self.shift, self.shift_sigma) * self.room_metres
        turned = certain(self.degrees, self.sigma_degrees)
        scaled = certain(abs(float(np.log(self.splat_from_model.scale))), self.scale_sigma)

        def beyond(shift: float, degrees: float, scale: float) -> bool:
            return bool(metres > shift or turned > degrees or scaled > np.log1p(scale))

        if beyond(settings.max_shift, settings.max_degrees, settings.max_scale):
            return "off"
        if beyond(settings.warn_shift, settings.warn_degrees, settings.warn_scale):
            return "a little off"
        return "fits"

    def __str__(self) -> str:
        scale = self.splat_from_model.scale
        length = self.frame.length_text
        at_scale = self.frame.scale
        known = np.isfinite(self.scale_sigma)
        size = f"{scale:.4f} times as large, " if known else ""
        return (
            f"against the model the splat is {size}turned by {self.degrees:.2f} degrees, and its "
            f"cameras stand {length(self.shift * at_scale)} from where the model has them (root "
            f"mean square, by {self.measured} of {self.tried} photos); one similarity explains all "
            f"but {length(self.remaining * at_scale)} and {self.remaining_degrees:.2f} degrees"
        )


def measure(
    scene: GaussianScene,
    references: References,
    image_folder: str | Path,
    metres_per_unit: float | None,
    settings: FrameCheckSettings,
    backend: str = "auto",
    matcher: Matcher | str | None = None,
    progress: bool = False,
) -> Misfit | None:
    """Looks for some references in the splat, near where their poses say.

    Renders are aligned with the photos; where that fails, matched, and aligned then.

    Args:
        scene, references: in one world, or what should be one.
        image_folder: of the references' photos.
        metres_per_unit: length of a world unit in metres; None where it is not known.
        settings: see :class:`FrameCheckSettings`.
        backend, matcher: as :class:`gscpe.Localizer`.
        progress: show a bar.

    Returns:
        None where fewer than ``settings.min_measured`` were found (or than there are).

    Raises:
        PhotoError, CameraError: a photo cannot be used.
    """
    chosen = evenly_spread(len(references), settings.references)
    chosen = chosen[::2] + chosen[1::2]  # the first half is spread over the map, too
    map_ = _map_of_the_splat_alone(scene, references, metres_per_unit)
    frame = map_.frame
    found: list[_Found] = []
    units = np.repeat([frame.scale**2, 1.0], 3)
    tried = 0
    with Localizer(map_, matcher=matcher, backend=backend, progress=progress) as localizer:
        for index in tqdm(
            chosen, desc="measuring how splat and poses fit", unit="photo", disable=not progress
        ):
            if tried >= _HOPELESS and not found:
                break
            if tried == (len(chosen) + 1) // 2 and len(found) >= settings.min_measured:
                misfit = _misfit(found, tried, frame)
                if misfit.verdict(settings) == "fits":
                    return misfit  # the other half would say the same
            tried += 1
            image = reference_image(references, index, image_folder)
            image, camera = at_most(image, references.cameras[index], settings.longest_side)
            pose = references.cam_from_world[index]
            prior = PosePrior(pose, _SIGMA / frame.scale, _SIGMA_DEGREES)
            result = localizer.localize(image, camera, prior)
            if (
                result.cam_from_world is not None
                and result.covariance is not None
                and result.aligned is not None
            ):
                unit = result.aligned.tolerance_unit
                variances = np.diag(result.covariance) * units
                found.append(_Found(pose, result.cam_from_world, variances, unit))
    if len(found) < min(settings.min_measured, len(references)):
        return None
    return _misfit(found, tried, frame)


@dataclass(frozen=True, eq=False)
class _Found:
    """A photo in the splat: ``cam_from_world`` of the model, and where it was found, the variances
    of that, (6,), and its tolerance unit."""

    in_model: Float64Array
    in_splat: Float64Array
    variances: Float64Array
    unit: float


def _misfit(found: list[_Found], tried: int, frame: MapFrame) -> Misfit:
    """All lengths of the fit are those of the map's frame, near its origin."""
    unit = float(np.median([each.unit for each in found]))
    in_model = frame.cam_from_map(np.stack([each.in_model for each in found]))
    in_splat = frame.cam_from_map(np.stack([each.in_splat for each in found]))
    fit = fit_similarity_of_poses(in_splat, in_model, lever=TYPICAL_DEPTH / unit)
    trusted = np.flatnonzero(fit.weights > 0)
    apart = [pose_difference(in_splat[i], in_model[i]).distance for i in trusted]
    variances = np.median([each.variances for each in found], axis=0)
    sigmas = np.sqrt([variances[:3].sum(), variances[3:].sum()])  # of one photo, by its own word
    many = np.sqrt(len(trusted))
    map_from_world = Similarity(frame.scale, np.eye(3), -frame.scale * frame.origin)
    return Misfit(
        splat_from_model=map_from_world.inverse() @ fit.b_from_a @ map_from_world,
        scale_sigma=fit.scale_sigma,
        shift_sigma=max(float(sigmas[0]), fit.rms_distance) / many / frame.scale,
        sigma_degrees=max(float(np.degrees(sigmas[1])), fit.rms_degrees) / many,
        shift=float(np.sqrt(np.mean(np.square(apart)))) / frame.scale,
        degrees=fit.b_from_a.degrees,
        remaining=fit.rms_distance / frame.scale,
        remaining_degrees=fit.rms_degrees,
        measured=len(trusted),
        tried=tried,
        room_metres=unit * frame.scale,
        frame=frame,
    )


def _map_of_the_splat_alone(
    scene: GaussianScene, references: References, metres_per_unit: float | None
) -> Map:
    """In the frame that the map of both will have."""
    frame = MapFrame.around(scene, references, metres_per_unit)
    nothing = np.zeros((0, 0), dtype=np.float32)
    return Map(
        scene=frame.scene_in_map(scene, typical_depth(scene, references)),
        references=replace(references, names=(), cam_from_world=np.zeros((0, 4, 4)), cameras=()),
        descriptors=GlobalDescriptors(vocabulary=nothing, descriptors=nothing),
        frame=frame,
    )
