# SPDX-License-Identifier: Apache-2.0
"""How much renders look like the photos of their poses: quick, small, and for any hypothesis
about how splat and poses go together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscpe.arrays import Float32Array
from gscpe.geometry.camera import Camera
from gscpe.geometry.spread import evenly_spread
from gscpe.mapping.reference_photos import reference_photo
from gscpe.photos import luminance
from gscpe.photos.photo import shrink
from gscpe.render import Renderer, local_correlation
from gscpe.scene import MapFrame, References
from gscpe.scene.map_frame import typical_depth
from gscpe.splats import GaussianScene

_LONGEST_SIDE = 320
_SEEN = 0.5


@dataclass(frozen=True)
class Look:
    """What renders show.

    Attributes:
        correlations: local correlation of each render and its photo, in [-1, 1]; 0 where there
            is nothing to compare.
        coverage: share of each render that shows the splat.
    """

    correlations: tuple[float, ...]
    coverage: tuple[float, ...]

    @property
    def best(self) -> float:
        """The highest correlation: some photos may show what the splat shows badly."""
        return max(self.correlations)

    @property
    def rank(self) -> float:
        """Orders hypotheses: the mean of the better half."""
        better = sorted(self.correlations, reverse=True)[: (len(self.correlations) + 1) // 2]
        return float(np.mean(better))


class PhotoComparison:
    """A few photos of the references, made small once, to be compared with many renders.

    Args:
        references: with respect to any frame; only names and cameras are read.
        image_folder: of their photos.
        count: photos, evenly spread.

    Raises:
        PhotoError: a photo cannot be read.
        CameraError: a photo is of another size than its camera.
    """

    def __init__(self, references: References, image_folder: str | Path, count: int) -> None:
        self.chosen = evenly_spread(len(references), count)
        self._photos = [self._small(references, index, image_folder) for index in self.chosen]

    @staticmethod
    def _small(
        references: References, index: int, image_folder: str | Path
    ) -> tuple[Camera, Float32Array]:
        photo = reference_photo(references, index, image_folder)
        camera = photo.camera
        scale = min(1.0, _LONGEST_SIDE / max(camera.width, camera.height))
        size = max(8, round(camera.width * scale)), max(8, round(camera.height * scale))
        return camera.resized(*size), shrink(luminance(photo.rgb), *size)

    def look(
        self,
        scene: GaussianScene,
        references: References,
        metres_per_unit: float | None,
        backend: str = "auto",
        progress: bool = False,
    ) -> Look:
        """What renders of a splat from the references' poses, both in one world, show.

        They are made in a map's frame, so that the unit and the origin of the world do not matter.
        """
        frame = MapFrame.around(scene, references, metres_per_unit)
        in_map = frame.scene_in_map(scene, typical_depth(scene, references))
        poses = frame.cam_from_map(references.cam_from_world)
        correlations, coverage = [], []
        with Renderer(in_map, backend, progress) as renderer:
            for index, (camera, photo) in zip(self.chosen, self._photos, strict=True):
                view = renderer.render(camera, poses[index])
                seen = view.opacity > _SEEN
                correlation = local_correlation(luminance(view.rgb), photo, seen)
                correlations.append(0.0 if np.isnan(correlation) else correlation)
                coverage.append(float(np.mean(seen)))
        return Look(tuple(correlations), tuple(coverage))
