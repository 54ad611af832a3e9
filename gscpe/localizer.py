"""The pipeline: one persistent object, one call a photo."""

from __future__ import annotations

import logging
from dataclasses import replace
from itertools import islice
from typing import Iterator, Sequence

import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.attempt import Attempt, Query, Start, to_result
from gscpe.clock import Clock
from gscpe.closing import Closing
from gscpe.coarse import estimate_coarse_pose
from gscpe.errors import CameraError, MapError, PoseError
from gscpe.geometry.camera import Camera
from gscpe.hypotheses import different_places, near_the_prior_first
from gscpe.localization_result import LocalizationResult
from gscpe.localizer_settings import LocalizerSettings
from gscpe.matching import Matcher, XFeatMatcher, make_matcher
from gscpe.pose_prior import PosePrior
from gscpe.refinement import RefinementResult, RefinementSettings, refine_pose
from gscpe.render import RenderedView, Renderer
from gscpe.retrieval import ReferenceIndex, RetrievedReference, open_describer
from gscpe.scene import Map, Photo, to_photo
from gscpe.scene.photo import resized_photo
from gscpe.unknown_camera import estimate_camera, ordinary_camera
from gscpe.verification import (
    doubt_about_coarse,
    doubt_about_refined,
    doubt_about_tracked,
)

_log = logging.getLogger(__name__)

_SAME_RESOLUTION = 1.03
"""Focal lengths in pixels within this factor need no resampling of the photo."""

_MOST_ENLARGED = 2.0
"""A photo with fewer pixels is enlarged at most this much: there is nothing more in it."""


class Localizer(Closing):
    """Localizes photos in one map. Holds the map on the graphics driver or in memory: keep it,
    use it from one thread at a time, and close it (or use it as a context manager).

    Args:
        map_: to localize in.
        settings: of every stage.
        matcher: of photo and render, or the name of one, or None for "auto"; see
            :func:`gscpe.matching.make_matcher`.
        backend, progress: as :class:`gscpe.render.Renderer`.

    Raises:
        RenderError: there is nothing to render with.
        SettingsError, ModelError, MissingDependencyError: of :func:`make_matcher`.
        MapError, ModelError, MissingDependencyError: queries cannot be described as the map's
            references were; see :func:`gscpe.retrieval.open_describer`.
    """

    def __init__(
        self,
        map_: Map,
        settings: LocalizerSettings | None = None,
        matcher: Matcher | str | None = None,
        backend: str = "auto",
        progress: bool = False,
    ) -> None:
        self.map = map_
        self.settings = settings or LocalizerSettings()
        self._matcher: Matcher = (
            make_matcher(matcher) if isinstance(matcher, str) else matcher or make_matcher()
        )
        self._describer = open_describer(map_.descriptors, self.settings.retrieval_model)
        self._index = ReferenceIndex(map_.descriptors.descriptors, self.settings.index)
        self._renderer = Renderer(map_.scene, backend, progress)

    def localize(
        self,
        image: UInt8Array,
        camera: Camera,
        prior: PosePrior | LocalizationResult | None = None,
    ) -> LocalizationResult:
        """Estimates the pose of a photo.

        Args:
            image: (H, W, 3) uint8 RGB.
            camera: its intrinsics; lens distortion is removed first.
            prior: where the camera probably is; or the result of the frame before, which
                counts only if it was localized. A sure prior skips retrieval and the coarse
                stage, an unsure one skips retrieval. Where that fails, all is done as without.

        Raises:
            PhotoError: shape or dtype of the image is wrong.
            CameraError: the camera is of another image size.
            PoseError: the prior is something else.
            MapError: the map has no references, and there is no prior.
            RenderError: rendering failed.
            ModelError: a trained network failed.
        """
        if not isinstance(camera, Camera):
            raise CameraError("localize needs a Camera; Localizer.estimate_camera finds one")
        if isinstance(prior, LocalizationResult):
            prior = None if prior.cam_from_world is None else PosePrior(prior.cam_from_world)
        if not isinstance(prior, PosePrior | None):
            raise PoseError(f"a prior is a PosePrior or a result, not a {type(prior).__name__}")
        if prior is None and not len(self.map.references):
            raise MapError(
                "this map has no reference photos to recognize a place by: give a prior pose, or "
                "build it with references"
            )
        clock = Clock()
        photo = self.at_the_maps_resolution(to_photo(image, camera))
        query = Query(photo, self._matcher, clock)
        best: Attempt | None = None
        tried = 0
        for start in self._starts(query, prior):
            attempt = self._attempt(query, start, prior)
            tried += 1
            _log.debug("from %s %s: %s", start.kind, start.reference or "", attempt.doubt or "ok")
            if best is None or attempt.rank() > best.rank():
                best = attempt
            if best.doubt is None and self._is_sure(best):
                break
        return to_result(best, tried, clock)

    def _starts(self, query: Query, prior: PosePrior | None) -> Iterator[Start]:
        """Where to begin, best first; retrieval runs only when it is reached."""
        settings, references = self.settings, self.map.references
        unit = self.map.metres_per_unit or 1.0
        if prior is not None:
            if (
                prior.translation_sigma * unit <= settings.near
                and prior.rotation_sigma_degrees <= settings.near_degrees
            ):
                yield Start("tracking", prior.cam_from_world)
            yield Start("prior", prior.cam_from_world)
        if not len(references):
            return
        poses, same_place = references.cam_from_world, settings.same_place / unit
        retrieved: Sequence[RetrievedReference] = self._retrieve(query)
        if prior is not None:
            retrieved = near_the_prior_first(retrieved, poses, prior, same_place)
        places = different_places(retrieved, poses, same_place)
        for reference in islice(places, settings.hypotheses):
            name = references.names[reference.index]
            yield Start("reference", poses[reference.index], name)

    def _attempt(self, query: Query, start: Start, prior: PosePrior | None) -> Attempt:
        settings, clock = self.settings, query.clock
        if start.kind == "tracking":
            assert prior is not None
            with clock.stage("refinement"):
                refinement = replace(settings.refinement, levels=settings.near_levels)
                refined = self._refine(query.photo, start.cam_from_world, refinement)
            doubt = doubt_about_tracked(prior, refined, settings.verification)
            return Attempt(start, None, refined, doubt)
        prepared = query.prepared
        with clock.stage("coarse"):
            coarse = estimate_coarse_pose(
                self._renderer,
                self._matcher,
                prepared,
                query.photo.camera,
                start.cam_from_world,
                settings.coarse,
                self.map.metres_per_unit,
            )
        doubt = doubt_about_coarse(coarse, query.photo.camera, settings.verification)
        if doubt is not None or coarse.cam_from_world is None:
            return Attempt(start, coarse, None, doubt)
        with clock.stage("refinement"):
            refined = self._refine(query.photo, coarse.cam_from_world, settings.refinement)
        doubt = doubt_about_refined(coarse, refined, settings.verification)
        return Attempt(start, coarse, refined, doubt)

    def _refine(
        self, photo: Photo, cam_from_world: Float64Array, settings: RefinementSettings
    ) -> RefinementResult:
        unit = self.map.metres_per_unit
        return refine_pose(self._renderer, photo, cam_from_world, settings, unit)

    def _is_sure(self, attempt: Attempt) -> bool:
        sure = self.settings.verification.sure_agreement
        return attempt.refined is not None and attempt.refined.agreement >= sure

    def estimate_camera(self, image: UInt8Array, guess: Camera | None = None) -> Camera:
        """The pinhole camera of a photo whose intrinsics are not known, for :meth:`localize`.

        One focal length is estimated, from matches with renders; the principal point is taken
        to be the guess's, and lens distortion to be small.

        Args:
            image: (H, W, 3) uint8 RGB.
            guess: for example :func:`gscpe.camera_from_exif`; None: an ordinary lens, and the
                principal point in the middle.

        Raises:
            CameraError: the photo does not tell; the message says why.
            PhotoError, MapError, RenderError, ModelError: as :meth:`localize`.
        """
        if not len(self.map.references):
            raise MapError("a map without reference photos cannot tell a camera's focal length")
        photo = to_photo(image, guess or ordinary_camera(image))
        at_size = resized_photo(photo, min(self._reference_width() / photo.camera.width, 2.0))
        query = Query(at_size, self._matcher, Clock())
        reason = "the photo has no features to recognize a place by"
        for start in self._starts(query, None):
            assert start.reference is not None
            index = self.map.references.names.index(start.reference)
            estimate = estimate_camera(
                self._renderer,
                self._matcher,
                query.prepared,
                at_size.camera,
                start.cam_from_world,
                self.map.references.cameras[index].without_distortion(),
                self.settings.coarse,
                self.settings.focal,
            )
            if isinstance(estimate, Camera):
                return estimate.resized(photo.camera.width, photo.camera.height)
            reason = estimate
        raise CameraError(f"the camera's focal length cannot be estimated: {reason}")

    def _reference_width(self) -> float:
        return float(np.median([camera.width for camera in self.map.references.cameras]))

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """The map as a camera sees it; as :meth:`gscpe.render.Renderer.render`."""
        return self._renderer.render(camera, cam_from_world)

    @property
    def renderer_description(self) -> str:
        """What renders: the OpenGL driver, or the CPU rasterizer and its threads."""
        return self._renderer.description

    def at_the_maps_resolution(self, photo: Photo) -> Photo:
        """The photo as it is localized: with as many pixels a radian as the references have.

        A splat looks right at the resolution of the photos that it was made of: nearer by, its
        Gaussians come apart; from afar, they cover each other.
        """
        references = self.map.references.cameras
        if not references:
            return photo
        theirs = float(np.median([camera.fx for camera in references]))
        scale = min(theirs / photo.camera.fx, _MOST_ENLARGED)
        if 1.0 / _SAME_RESOLUTION <= scale <= _SAME_RESOLUTION:
            return photo
        return resized_photo(photo, scale)

    def _retrieve(self, query: Query) -> tuple[RetrievedReference, ...]:
        """The most similar reference photos; features that matching needs are not detected
        again to describe the photo."""
        photo, features = query.photo, None
        if isinstance(self._matcher, XFeatMatcher):
            features = query.prepared.features
        with query.clock.stage("retrieval"):
            described = self._describer.describe(photo.rgb, features, photo.valid)
            if not np.any(described):
                return ()
            return self._index.search(described, self.settings.retrieved)

    def close(self) -> None:
        """Gives the renderer's memory back; the localizer cannot be used after."""
        self._renderer.close()
