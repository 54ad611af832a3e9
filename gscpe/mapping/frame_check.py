"""Whether a splat and its reference poses are in the same frame."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from gscpe.errors import MapError
from gscpe.render import Renderer, local_correlation
from gscpe.scene import GaussianScene, References, luminance, read_image_of, to_photo
from gscpe.scene.photo import shrink
from gscpe.scene.turned import Y_AND_Z_NEGATED, turned

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
    _refuse(max(_correlations(scene, references, image_folder, backend, progress)))


def with_fitting_axes(
    scene: GaussianScene,
    references: References,
    image_folder: str | Path,
    backend: str = "auto",
    progress: bool = False,
    axes_are_open: bool = False,
) -> GaussianScene:
    """The scene as it is, or turned by a half turn about x (y and z negated), whichever looks
    like the photos.

    Many ``.spz`` and ``.sog`` files have these other axes, and do not say so.

    Args:
        scene, references, image_folder, backend, progress: as :func:`check_frames`.
        axes_are_open: compare both at once (``gscpe.scene.splat_kind.may_have_other_axes``); else
            the scene is only turned where it does not fit as it is.

    Raises:
        MapError: neither looks like its photos.
    """
    where = (references, image_folder, backend, progress)
    as_stored = max(_correlations(scene, *where))
    if as_stored >= _MIN_CORRELATION and not axes_are_open:
        return scene
    other = turned(scene, Y_AND_Z_NEGATED)
    as_turned = max(_correlations(other, *where))
    _refuse(max(as_stored, as_turned))
    found = f"correlation with the photos {as_turned:.2f}, as it is stored {as_stored:.2f}"
    if as_turned > as_stored:
        _log.warning("the splat is turned to fit the photos, y and z negated (%s)", found)
        return other
    _log.info("the splat keeps its axes (y and z negated: %s)", found)
    return scene


def _correlations(
    scene: GaussianScene,
    references: References,
    image_folder: str | Path,
    backend: str,
    progress: bool,
) -> list[float]:
    """Of some photos and renders from their poses; 0 where the render shows nothing."""
    correlations = []
    chosen = np.unique(np.linspace(0, len(references) - 1, _PHOTOS).astype(int))
    with Renderer(scene, backend, progress) as renderer:
        for index in chosen:
            camera = references.cameras[index]
            path = Path(image_folder) / references.names[index]
            photo = to_photo(read_image_of(path, camera), camera)
            scale = min(1.0, _LONGEST_SIDE / max(camera.width, camera.height))
            size = max(8, round(camera.width * scale)), max(8, round(camera.height * scale))
            view = renderer.render(photo.camera.resized(*size), references.cam_from_world[index])
            small = shrink(luminance(photo.rgb), *size)
            correlation = local_correlation(luminance(view.rgb), small, view.opacity > 0.5)
            _log.debug("%s looks like its photo to %.2f", references.names[index], correlation)
            correlations.append(0.0 if np.isnan(correlation) else correlation)
    return correlations


def _refuse(best: float) -> None:
    """Raises MapError where not even the best correlation is enough."""
    if best < _MIN_CORRELATION:
        raise MapError(
            "the splat does not look like the photos from their poses (correlation "
            f"{best:.2f} at best): the COLMAP model seems to be in another frame or "
            "scale than the splat. Give the model that the splat was trained on, and export the "
            "splat without re-centring or scaling"
        )
