"""Whether a splat and its reference poses are in the same frame."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from gscpe.errors import MapError
from gscpe.render import Renderer, local_correlation
from gscpe.scene import GaussianScene, References, luminance, read_image, to_photo
from gscpe.scene.photo import shrink

_log = logging.getLogger(__name__)

_PHOTOS = 6
_LONGEST_SIDE = 320
_MIN_CORRELATION = 0.2


def check_frames(
    scene: GaussianScene,
    references: References,
    image_folder: str | Path,
    backend: str = "auto",
    progress: bool = False,
) -> None:
    """Renders some reference poses and compares with their photos.

    Trainers may move, turn or scale the scene that they export; a COLMAP model of the frame
    before does not fit then, and no photo would be localized.

    Raises:
        MapError: none of the renders looks like its photo.
    """
    correlations = []
    chosen = np.unique(np.linspace(0, len(references) - 1, _PHOTOS).astype(int))
    with Renderer(scene, backend, progress) as renderer:
        for index in chosen:
            camera = references.cameras[index]
            path = Path(image_folder) / references.names[index]
            photo = to_photo(read_image(path), camera)
            scale = min(1.0, _LONGEST_SIDE / max(camera.width, camera.height))
            size = max(8, round(camera.width * scale)), max(8, round(camera.height * scale))
            view = renderer.render(photo.camera.resized(*size), references.cam_from_world[index])
            small = shrink(luminance(photo.rgb), *size)
            correlation = local_correlation(luminance(view.rgb), small, view.opacity > 0.5)
            _log.debug("%s looks like its photo to %.2f", references.names[index], correlation)
            correlations.append(0.0 if np.isnan(correlation) else correlation)
    if max(correlations) < _MIN_CORRELATION:
        raise MapError(
            "the splat does not look like the photos from their poses (correlation "
            f"{max(correlations):.2f} at best): the COLMAP model seems to be in another frame or "
            "scale than the splat. Give the model that the splat was trained on, and export the "
            "splat without re-centring or scaling"
        )
