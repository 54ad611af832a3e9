"""The pipeline: one persistent object, one call a photo."""

from __future__ import annotations

import logging
import threading
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Iterable, Iterator, Sequence

import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.closing import Closing
from gscpe.coarse import estimate_coarse_pose
from gscpe.errors import CameraError, ClosedError, MapError, PoseError, SettingsError
from gscpe.geometry.camera import Camera
from gscpe.geometry.se3 import check_transform
from gscpe.localization.attempt import Attempt, PreparedPhoto
from gscpe.localization.border import prior_in_map, view_in_world
from gscpe.localization.clock import Clock
from gscpe.localization.light import trouble_with_light
from gscpe.localization.observer import Observer
from gscpe.localization.result import NO_FEATURES, LocalizationResult
from gscpe.localization.settings import LocalizerSettings
from gscpe.localization.starts import (
    PosePrior,
    Start,
    different_places,
    near_the_prior_first,
)
from gscpe.localization.unknown_camera import estimate_camera, ordinary_camera
from gscpe.localization.verification import (
    doubt_about_aligned,
    doubt_about_coarse,
    doubt_about_tracked,
)
from gscpe.matching import Matcher, XFeatMatcher, make_matcher
from gscpe.refinement import RefinementResult, RefinementSettings, refine_pose
from gscpe.render import RenderedView, Renderer
from gscpe.retrieval import ReferenceIndex, RetrievedReference, open_describer
from gscpe.scene import GaussianScene, Map, Photo, open_map, to_photo
from gscpe.scene.image_array import check_image
from gscpe.scene.photo import resized_photo

_log = logging.getLogger(__name__)

_MORE = 8
"""Times as many references are retrieved when those before showed too few different places."""


class Localizer(Closing):
    """Localizes photos in one map. Holds the map on the graphics driver or in memory: keep it,
    and close it (or use it as a context manager). Threads may share it: one call at a time is
    worked on, the others wait; for more at a time, take processes (gscpe.batch).

    Args:
        map_: to localize in, or the path of its folder.
        settings: of every stage.
        matcher: of photo and render, or the name of one, or None for "auto"; see
            :func:`gscpe.make_matcher`.
        backend, progress: as :class:`gscpe.Renderer`.

    Raises:
        MapError: what is given is no map, nor the folder of one.
        RenderError: there is nothing to render with.
        SettingsError, ModelError, MissingDependencyError: of :func:`make_matcher`.
        MapError, ModelError, MissingDependencyError: queries cannot be described as the map's
            references were; see :func:`gscpe.retrieval.open_describer`.
    """

    def __init__(
        self,
        map_: Map | str | Path,
        settings: LocalizerSettings | None = None,
        matcher: Matcher | str | None = None,
        backend: str = "auto",
        progress: bool = False,
    ) -> None:
        if isinstance(map_, GaussianScene):
            raise MapError(
                "a Localizer needs a Map, not a splat alone: gscpe.build_map makes one of a splat "
                "and its photos, gscpe.map_without_references(scene) one that needs prior poses"
            )
        if not isinstance(settings, LocalizerSettings | None):
            raise SettingsError(
                f"a Localizer's settings are LocalizerSettings, not a {type(settings).__name__}"
            )
        map_ = map_ if isinstance(map_, Map) else open_map(map_)
        self.map = map_
        self.settings = settings or LocalizerSettings()
        self._matcher: Matcher = (
            make_matcher(matcher) if isinstance(matcher, str) else matcher or make_matcher()
        )
        self._describer = open_describer(map_.descriptors, self.settings.retrieval_model)
        self._index = ReferenceIndex(map_.descriptors.descriptors, self.settings.index)
        self._renderer = Renderer(map_.scene, backend, progress)
        self._lock = threading.RLock()  # an observer may render
        self._closed = False

    @contextmanager
    def _while_open(self) -> Iterator[None]:
        """One thread at a time.

        Raises:
            ClosedError: the localizer is closed.
        """
        with self._lock:
            if self._closed:
                raise ClosedError("this localizer is closed")
            yield

    def localize(
        self,
        image: UInt8Array,
        camera: Camera,
        prior: PosePrior | LocalizationResult | None = None,
        references: Sequence[str] | None = None,
        observer: Observer | None = None,
    ) -> LocalizationResult:
        """Estimates the pose of a photo.

        Args:
            image: (H, W, 3) uint8 RGB, as :func:`gscpe.read_image` has it, and not BGR as OpenCV
                has it; or (H, W, 4), where pixels that are transparent are left out.
            camera: its intrinsics; lens distortion is removed first.
            prior: where the camera probably is; or the result of the frame before, which
                counts only if it was localized. A sure prior skips retrieval and the coarse
                stage, an unsure one skips retrieval, and a position alone has the references
                near it tried first. Where that fails, all is done as without.
            references: names of reference photos to begin with, most similar first, in place of
                the map's own retrieval.
            observer: is told what is done, as it is done.

        Raises:
            PhotoError: shape or dtype of the image is wrong.
            CameraError: the camera is of another image size, or is no Camera.
            PoseError: the prior is something else.
            MapError: the map has no references, and there is no prior pose; or ``references``
                names one that it does not have.
            RenderError: rendering failed.
            ModelError: a trained network failed.
            ClosedError: the localizer is closed.
        """
        with self._while_open():
            return self._localize(image, camera, prior, references, observer or Observer())

    def _localize(
        self,
        image: UInt8Array,
        camera: Camera,
        prior: PosePrior | LocalizationResult | None,
        references: Sequence[str] | None,
        observer: Observer,
    ) -> LocalizationResult:
        if not isinstance(camera, Camera):
            raise CameraError("localize needs a Camera; Localizer.estimate_camera finds one")
        frame = self.map.frame
        if isinstance(prior, LocalizationResult):
            prior = self._prior_of(prior)
        if not isinstance(prior, PosePrior | None):
            raise PoseError(f"a prior is a PosePrior or a result, not a {type(prior).__name__}")
        if isinstance(references, str):
            raise MapError(f"references are a list of names: give [{references!r}]")
        knows_rotation = prior is not None and self._knows_rotation(prior)
        if not knows_rotation and not len(self.map.references):
            raise MapError(
                "this map has no reference photos to recognize a place by: give a prior pose, or "
                "build it with references"
            )
        if prior is not None:
            prior = prior_in_map(prior, frame)
        clock = Clock()
        photo = self.at_the_maps_resolution(to_photo(image, camera))
        query = PreparedPhoto(photo, self._matcher, clock)
        attempts: list[Attempt] = []
        for start in self._starts(query, prior, references):
            attempt = self._attempt(query, start, prior, observer)
            _log.debug("from %s %s: %s", start.kind, start.reference or "", attempt.doubt or "ok")
            observer.attempted(attempt)
            attempts.append(attempt)
            best = max(attempts, key=Attempt.rank)
            if best.doubt is None and self._is_sure(best):
                break
        result = LocalizationResult.of(attempts, camera, frame, self.settings, clock.seconds())
        return result if result.localized else result.because(trouble_with_light(photo))

    def _prior_of(self, result: LocalizationResult) -> PosePrior | None:
        """The result of the frame before says where the camera was, some centimetres ago."""
        if result.cam_from_world is None:
            return None
        return PosePrior(
            result.cam_from_world,
            self.settings.motion_sigma / self.map.frame.scale,
            self.settings.motion_sigma_degrees,
        )

    def _starts(
        self,
        query: PreparedPhoto,
        prior: PosePrior | None = None,
        names: Sequence[str] | None = None,
    ) -> Iterator[Start]:
        """Where to begin, best first; retrieval runs only when it is reached."""
        settings, references = self.settings, self.map.references
        if prior is not None:
            if (
                prior.translation_sigma <= settings.near
                and prior.rotation_sigma_degrees <= settings.near_degrees
            ):
                yield Start("tracking", prior.cam_from_world)
            if self._knows_rotation(prior):
                yield Start("prior", prior.cam_from_world)
        if not len(references):
            return
        poses, same_place = references.cam_from_world, settings.same_place
        ranking: Iterable[RetrievedReference]
        ranking = self._retrieve(query) if names is None else self._named(names)
        if prior is not None:
            reach = settings.prior_sigmas * prior.translation_sigma + same_place
            ranking = near_the_prior_first(ranking, poses, prior, reach)
        places = different_places(ranking, poses, same_place, settings.same_place_degrees)
        for reference in islice(places, settings.hypotheses):
            name = references.names[reference.index]
            yield Start("reference", poses[reference.index], name)

    def _knows_rotation(self, prior: PosePrior) -> bool:
        """Whether a render from the prior can show what the photo shows."""
        return prior.rotation_sigma_degrees <= self.settings.prior_degrees

    def _attempt(
        self, query: PreparedPhoto, start: Start, prior: PosePrior | None, observer: Observer
    ) -> Attempt:
        settings, clock = self.settings, query.clock
        if start.kind == "tracking":
            assert prior is not None
            with clock.stage("refinement"):
                refinement = replace(settings.refinement, levels=settings.near_levels)
                aligned = self._refine(query.photo, start.cam_from_world, refinement, observer)
            doubt = doubt_about_tracked(prior, aligned, settings.verification, self.map.frame)
            return Attempt(start, None, aligned, doubt)
        prepared = query.for_matching
        with clock.stage("coarse"):
            coarse = estimate_coarse_pose(
                self._renderer,
                self._matcher,
                prepared,
                query.photo.camera,
                start.cam_from_world,
                settings.coarse,
                observer,
            )
        doubt = doubt_about_coarse(coarse, query.photo.camera, settings.verification)
        if doubt is not None or coarse.cam_from_world is None:
            return Attempt(start, coarse, None, doubt)
        with clock.stage("refinement"):
            aligned = self._refine(
                query.photo, coarse.cam_from_world, settings.refinement, observer
            )
        doubt = doubt_about_aligned(
            coarse, aligned, settings.verification, settings.fusion, self.map.frame
        )
        return Attempt(start, coarse, aligned, doubt)

    def _refine(
        self,
        photo: Photo,
        cam_from_world: Float64Array,
        settings: RefinementSettings,
        observer: Observer,
    ) -> RefinementResult:
        return refine_pose(self._renderer, photo, cam_from_world, settings, observer)

    def _is_sure(self, attempt: Attempt) -> bool:
        sure = self.settings.verification.sure_agreement
        return attempt.aligned is not None and attempt.aligned.agreement >= sure

    def estimate_camera(self, image: UInt8Array, guess: Camera | None = None) -> Camera:
        """The pinhole camera of a photo whose intrinsics are not known, for :meth:`localize`.

        One focal length is estimated, from matches with renders; the principal point is taken
        to be the guess's, and lens distortion to be small.

        Args:
            image: (H, W, 3) uint8 RGB, not OpenCV's BGR.
            guess: for example :func:`gscpe.camera_from_exif`; None: an ordinary lens, and the
                principal point in the middle.

        Raises:
            CameraError: the photo does not tell; the message says why.
            PhotoError, MapError, RenderError, ModelError, ClosedError: as :meth:`localize`.
        """
        with self._while_open():
            return self._estimate_camera(image, guess)

    def _estimate_camera(self, image: UInt8Array, guess: Camera | None) -> Camera:
        if not len(self.map.references):
            raise MapError("a map without reference photos cannot tell a camera's focal length")
        image = check_image(image)
        photo = to_photo(image, guess or ordinary_camera(image, self.settings.focal))
        larger = min(self._reference_width() / photo.camera.width, self.settings.most_enlarged)
        at_size = resized_photo(photo, larger)
        query = PreparedPhoto(at_size, self._matcher, Clock())
        reason = NO_FEATURES
        for start in self._starts(query):
            assert start.reference is not None
            index = self.map.references.names.index(start.reference)
            estimate = estimate_camera(
                self._renderer,
                self._matcher,
                query.for_matching,
                at_size.camera,
                start.cam_from_world,
                self.map.references.cameras[index].without_distortion(),
                self.settings.coarse,
                self.settings.focal,
            )
            if isinstance(estimate, Camera):
                return estimate.resized(photo.camera.width, photo.camera.height)
            reason = estimate
        reason = trouble_with_light(photo) or reason
        raise CameraError(f"the camera's focal length cannot be estimated: {reason}")

    def _reference_width(self) -> float:
        return float(np.median([camera.width for camera in self.map.references.cameras]))

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """The map as a camera sees it; as :meth:`gscpe.render.Renderer.render`. Pose and depths
        are with respect to the world."""
        cam_from_world = check_transform(cam_from_world, "cam_from_world")
        with self._while_open():
            view = self._renderer.render(camera, self.map.frame.cam_from_map(cam_from_world))
        return view_in_world(view, self.map.frame)

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
        theirs = float(np.median([camera.without_distortion().fx for camera in references]))
        scale = min(theirs / photo.camera.fx, self.settings.most_enlarged)
        if 1.0 / self.settings.same_resolution <= scale <= self.settings.same_resolution:
            return photo
        return resized_photo(photo, scale)

    def _named(self, names: Sequence[str]) -> tuple[RetrievedReference, ...]:
        known = {name: index for index, name in enumerate(self.map.references.names)}
        missing = [name for name in names if name not in known]
        if missing:
            raise MapError(f"the map has no reference photo {missing[0]!r}")
        return tuple(RetrievedReference(known[name], np.nan) for name in names)

    def _retrieve(self, query: PreparedPhoto) -> Iterator[RetrievedReference]:
        """All reference photos, most similar first, as far as they are asked for; features that
        matching needs are not detected again to describe the photo."""
        photo, features = query.photo, None
        if isinstance(self._matcher, XFeatMatcher):
            features = query.for_matching.features
        with query.clock.stage("retrieval"):
            described = self._describer.describe(photo.rgb, features, photo.valid)
        if np.any(described):
            with query.clock.stage("retrieval"):
                found = self._index.search(described, self.settings.retrieved)
            yield from found
            given = {reference.index for reference in found}
            while len(given) < len(self.map.references):
                with query.clock.stage("retrieval"):
                    found = self._index.search(described, _MORE * len(given))
                more = [reference for reference in found if reference.index not in given]
                if not more:
                    return  # an index with few probes does not reach all
                yield from more
                given |= {reference.index for reference in more}

    def close(self) -> None:
        """Releases the renderer's memory, once a call that is being worked on is finished; the
        localizer cannot be used after."""
        with self._lock:
            self._closed = True
            self._renderer.close()
