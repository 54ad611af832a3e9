"""The misfit of a splat and its reference poses, measured: where the cameras really are in the
splat, and the similarity that takes the poses there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array
from gscpe.geometry.similarity_transform import Similarity, fit_similarity_of_poses
from gscpe.localization import Localizer, PosePrior
from gscpe.mapping.reference_photos import at_most, reference_image, spread
from gscpe.mapping.settings import FrameCheckSettings
from gscpe.matching import Matcher
from gscpe.scene import GaussianScene, GlobalDescriptors, Map, MapFrame, References
from gscpe.scene.map_frame import TYPICAL_DEPTH, typical_depth

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
        off_scale = abs(np.log(self.splat_from_model.scale))
        if not off_scale > settings.sure * self.scale_sigma:
            off_scale = 0.0
        metres = self.shift * self.room_metres

        def beyond(shift: float, degrees: float, scale: float) -> bool:
            return bool(metres > shift or self.degrees > degrees or off_scale > np.log1p(scale))

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
            f"against the model the splat is {size}turned by {self.degrees:.2f} degrees and "
            f"shifted so that its cameras stand {length(self.shift * at_scale)} away (root mean "
            f"square of {self.measured} references of {self.tried}); a similarity leaves "
            f"{length(self.remaining * at_scale)} and {self.remaining_degrees:.2f} degrees of it"
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
    chosen = spread(len(references), settings.references)
    map_ = _map_of_the_splat_alone(scene, references, metres_per_unit)
    frame = map_.frame
    found: list[int] = []
    in_splat: list[Float64Array] = []
    units: list[float] = []
    tried = 0
    with Localizer(map_, matcher=matcher, backend=backend, progress=progress) as localizer:
        for index in tqdm(
            chosen, desc="measuring how splat and poses fit", unit="photo", disable=not progress
        ):
            if tried >= _HOPELESS and not found:
                break
            tried += 1
            image = reference_image(references, index, image_folder)
            image, camera = at_most(image, references.cameras[index], settings.longest_side)
            pose = references.cam_from_world[index]
            prior = PosePrior(pose, _SIGMA / frame.scale, _SIGMA_DEGREES)
            result = localizer.localize(image, camera, prior)
            if result.cam_from_world is None or result.aligned is None:
                continue
            found.append(index)
            in_splat.append(frame.cam_from_map(result.cam_from_world))
            units.append(result.aligned.tolerance_unit)
    if len(found) < min(settings.min_measured, len(references)):
        return None
    unit = float(np.median(units))
    in_model = frame.cam_from_map(references.cam_from_world[found])
    fit = fit_similarity_of_poses(np.stack(in_splat), in_model, lever=TYPICAL_DEPTH / unit)
    trusted = fit.weights > 0
    centres = [-np.einsum("nji,nj->ni", p[:, :3, :3], p[:, :3, 3])
               for p in (np.stack(in_splat)[trusted], in_model[trusted])]  # fmt: skip
    shift = float(np.sqrt(np.mean(np.sum((centres[0] - centres[1]) ** 2, axis=1))))
    map_from_world = Similarity(frame.scale, np.eye(3), -frame.scale * frame.origin)
    return Misfit(
        splat_from_model=map_from_world.inverse() @ fit.b_from_a @ map_from_world,
        scale_sigma=fit.scale_sigma,
        shift=shift / frame.scale,
        degrees=fit.b_from_a.degrees,
        remaining=fit.rms_distance / frame.scale,
        remaining_degrees=fit.rms_degrees,
        measured=int(np.count_nonzero(trusted)),
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
