# SPDX-License-Identifier: Apache-2.0
"""Whether a splat and its reference poses are in the same frame, and how to bring them there."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gscpe.errors import MapError
from gscpe.geometry.similarity_transform import Similarity
from gscpe.mapping.diagnosis import diagnose_splat, rounded_coordinates, what_was_seen
from gscpe.mapping.frame_candidates import FrameCandidate, frame_candidates
from gscpe.mapping.looks import Look, PhotoComparison
from gscpe.mapping.misfit import Misfit, measure
from gscpe.mapping.settings import FrameCheckSettings
from gscpe.matching import Matcher
from gscpe.scene import References
from gscpe.scene.moved import move_references
from gscpe.splats import GaussianScene
from gscpe.splats.turned import Y_AND_Z_NEGATED, turned

_log = logging.getLogger(__name__)

_WORTH_A_TRY = 0.1
"""Correlation from which photos are looked for from guessed poses."""

_GIVE_THE_MODEL = (
    "Give the COLMAP model that the splat was trained on, and export the splat without re-centring "
    "or scaling; or say what was done to it (gscpe build-map --transform FILE)"
)


def check_frames(
    scene: GaussianScene,
    references: References,
    image_folder: str | Path,
    settings: FrameCheckSettings | None = None,
    metres_per_unit: float | None = 1.0,
    backend: str = "auto",
    matcher: Matcher | str | None = None,
    *,
    progress: bool = False,
) -> Misfit | None:
    """Measures how splat and reference poses fit together, and refuses what does not.

    Trainers and editors move, turn and scale the scenes that they export; where a COLMAP model of
    the frame before is given, poses come out wrong, or no photo is localized.

    Args:
        scene, references: in one world, or what should be one.
        image_folder: of the references' photos.
        settings: how much is warned of, and how much is refused.
        metres_per_unit: length of a world unit in metres; None where it is not known.
        backend, matcher: as :class:`gscpe.Localizer`.
        progress: show a bar.

    Returns:
        The misfit; None, with a warning in the log, where some renders look like their photos, but
        too few photos are found in the splat to measure it.

    Raises:
        MapError: they do not fit; the message says what was seen and measured, and why it may be.
        PhotoError, CameraError: a photo cannot be used.
    """
    settings = settings or FrameCheckSettings()
    rounded = rounded_coordinates(scene)
    if rounded is not None:
        _log.warning("%s", rounded)
    photos = _Photos(image_folder, metres_per_unit, backend, matcher, progress)
    found = _find(scene, references, photos, settings)
    misfit = found.misfit
    if misfit is None:
        _log.warning(
            "renders look like their photos (correlation %.2f at best), but too few photos are "
            "found near their poses to measure how well the splat fits them", found.look.best
        )  # fmt: skip
        return None
    if found.candidate is not None:
        raise MapError(
            f"splat and poses do not fit as they are; they do if the splat was "
            f"{found.candidate.name}: {misfit}. gscpe build-map --fit makes them fit"
        )
    verdict = misfit.verdict(settings)
    if verdict == "off":
        raise MapError(
            f"splat and poses do not fit: {misfit}. Give the model that the splat was trained on, "
            "or gscpe build-map --fit, which makes them fit"
        )
    if verdict == "a little off":
        _log.warning(
            "splat and poses do not quite fit, and poses will be as far off: %s. gscpe build-map "
            "--fit makes them fit", misfit
        )  # fmt: skip
    remaining = misfit.remaining * misfit.room_metres
    if remaining > settings.max_shift or misfit.remaining_degrees > settings.max_degrees:
        _log.warning("the splat is bent against the poses: %s", misfit)
    _log.info("%s", misfit)
    return misfit


def measure_misfit(
    scene: GaussianScene,
    references: References,
    image_folder: str | Path,
    settings: FrameCheckSettings | None = None,
    metres_per_unit: float | None = 1.0,
    backend: str = "auto",
    matcher: Matcher | str | None = None,
    *,
    progress: bool = False,
) -> Misfit:
    """The same, however large it is: ``Misfit.splat_from_model`` mends it (see
    gscpe.scene.moved). Arguments as :func:`check_frames`.

    Raises:
        MapError: too few of the photos are found in the splat to measure it.
        PhotoError, CameraError: a photo cannot be used.
    """
    photos = _Photos(image_folder, metres_per_unit, backend, matcher, progress)
    found = _find(scene, references, photos, settings or FrameCheckSettings())
    if found.misfit is None:
        raise MapError(
            f"too few photos are found in the splat to fit the poses to it (renders look like "
            f"photos to a correlation of {found.look.best:.2f} at best)"
        )
    return found.misfit


def with_fitting_axes(
    scene: GaussianScene,
    references: References,
    image_folder: str | Path,
    settings: FrameCheckSettings | None = None,
    metres_per_unit: float | None = 1.0,
    backend: str = "auto",
    *,
    progress: bool = False,
    axes_are_open: bool = False,
) -> GaussianScene:
    """The scene as it is, or turned by a half turn about x (y and z negated), whichever looks
    like the photos; as it is, where neither does (:func:`check_frames` says why).

    Many ``.spz`` and ``.sog`` files have these other axes, and do not say so.

    Args:
        scene, references, image_folder, settings, metres_per_unit, backend, progress: as
            :func:`check_frames`.
        axes_are_open: compare both at once (``gscpe.splats.splat_kind.may_have_other_axes``); else
            the scene is only turned where it does not fit as it is.
    """
    settings = settings or FrameCheckSettings()
    least = settings.min_correlation
    photos = PhotoComparison(references, image_folder, settings.photos)
    as_stored = photos.look(scene, references, metres_per_unit, backend, progress).best
    if as_stored >= least and not axes_are_open:
        return scene
    other = turned(scene, Y_AND_Z_NEGATED)
    as_turned = photos.look(other, references, metres_per_unit, backend).best
    found = f"correlation with the photos {as_turned:.2f}, as it is stored {as_stored:.2f}"
    if as_turned > as_stored and as_turned >= least:
        _log.warning("the splat is turned to fit the photos, y and z negated (%s)", found)
        return other
    _log.info("the splat keeps its axes (y and z negated: %s)", found)
    return scene


@dataclass(frozen=True)
class _Found:
    """The misfit, None where it cannot be measured; and the frame that was guessed for it."""

    look: Look
    misfit: Misfit | None
    candidate: FrameCandidate | None = None


@dataclass(frozen=True)
class _Photos:
    """Where the photos are, and with what they are compared; as in :func:`check_frames`."""

    folder: str | Path
    metres_per_unit: float | None
    backend: str
    matcher: Matcher | str | None
    progress: bool


def _find(
    scene: GaussianScene, references: References, photos: _Photos, settings: FrameCheckSettings
) -> _Found:
    """Raises MapError where nothing fits."""
    if not len(references):
        raise MapError("there are no reference photos to check the splat by")
    least = settings.min_correlation
    unit, backend = photos.metres_per_unit, photos.backend
    comparison = PhotoComparison(references, photos.folder, settings.photos)
    look = comparison.look(scene, references, unit, backend, photos.progress)
    _log.debug("renders look like their photos to %s", np.round(look.correlations, 2))
    if look.best < least:
        wrong = diagnose_splat(scene, references, unit, comparison, look, least, backend)
        if wrong is not None:
            raise MapError(f"the splat does not look like the photos: {wrong}")
    if max(look.coverage) > 0.0:
        misfit = _measure(scene, references, photos, settings)
        if misfit is not None:
            return _Found(look, misfit)
    guess = _from_a_guess(scene, references, photos, settings, comparison, look)
    if guess is not None:
        return guess
    if look.best >= least:
        return _Found(look, None)
    raise MapError(
        f"{what_was_seen(scene, references, look)}. The model seems to be in another frame or "
        f"scale than the splat. {_GIVE_THE_MODEL}"
    )


def _measure(
    scene: GaussianScene, references: References, photos: _Photos, settings: FrameCheckSettings
) -> Misfit | None:
    return measure(
        scene, references, photos.folder, photos.metres_per_unit, settings, photos.backend,
        photos.matcher, photos.progress,
    )  # fmt: skip


def _from_a_guess(
    scene: GaussianScene,
    references: References,
    photos: _Photos,
    settings: FrameCheckSettings,
    comparison: PhotoComparison,
    seen: Look,
) -> _Found | None:
    """The candidate whose renders look most like the photos, measured from there."""
    best = None
    for candidate in frame_candidates(references):
        moved = move_references(references, candidate.splat_from_model)
        look = comparison.look(scene, moved, photos.metres_per_unit, photos.backend)
        _log.debug("if the splat was %s: correlation %.2f", candidate.name, look.rank)
        if best is None or look.rank > best[0].rank:
            best = look, candidate, moved
    assert best is not None
    look, candidate, moved = best
    if look.rank < max(_WORTH_A_TRY, seen.rank):
        return None
    misfit = _measure(scene, moved, photos, settings)
    if misfit is None:
        return None
    misfit = _from_the_model(misfit, candidate.splat_from_model, references)
    return _Found(look, misfit, candidate)


def _from_the_model(misfit: Misfit, guess: Similarity, references: References) -> Misfit:
    """A misfit that was measured from guessed poses, as one of the model's own."""
    whole = misfit.splat_from_model @ guess
    centres = -np.einsum(
        "nji,nj->ni", references.cam_from_world[:, :3, :3], references.cam_from_world[:, :3, 3]
    )
    moved = np.linalg.norm(whole.apply(centres) - centres, axis=1)
    return replace(
        misfit,
        splat_from_model=whole,
        shift=float(np.sqrt(np.mean(moved**2))),
        degrees=whole.degrees,
    )
