# SPDX-License-Identifier: Apache-2.0
"""The pipeline: one persistent object, one call a photo."""

from __future__ import annotations

import os
import threading
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Iterator, Sequence

import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.blas import one_blas_thread
from gscpe.closing import Closing
from gscpe.coarse import estimate_coarse_pose
from gscpe.errors import CameraError, ClosedError, MapError, PoseError, SettingsError
from gscpe.geometry.camera import Camera
from gscpe.geometry.se3 import check_transform
from gscpe.localization.attempt import Attempt
from gscpe.localization.beside import Beside
from gscpe.localization.border import InWorld, attempt_in_world, prior_in_map, view_in_world
from gscpe.localization.chain import Chain
from gscpe.localization.clock import Clock
from gscpe.localization.light import trouble_with_light
from gscpe.localization.matchers import Matchers
from gscpe.localization.observer import Observer
from gscpe.localization.places import Places
from gscpe.localization.result import LocalizationResult
from gscpe.localization.settings import LocalizerSettings
from gscpe.localization.stages import Stages
from gscpe.localization.starts import PosePrior, Start
from gscpe.localization.unknown_camera import UnknownCameras
from gscpe.localization.verification import doubt_about_coarse
from gscpe.matching import Matcher
from gscpe.photos import Photo, to_photo
from gscpe.photos.photo import resized_photo
from gscpe.render import RenderedView, Renderer
from gscpe.scene import Map, open_map
from gscpe.splats import GaussianScene

_LEAST_SIDE = 48  # of a photo, pixels


class Localizer(Closing):
    """Localizes photos in one map. Holds the map on the graphics driver or in memory: create it
    once for many photos, and close it (or use it as a context manager). Threads may share it: it
    handles one call at a time, and the others wait; to work in parallel, use processes
    (gscpe.batch).

    Args:
        map_: to localize in, or the path of its folder.
        settings: of every stage.
        matcher: of photo and render; or the name of one, or None for "auto", see
            :func:`gscpe.make_matcher`: photos that are not found with it are then tried with those
            that cost more (``LocalizerSettings.escalate``).
        backend, progress: as :class:`gscpe.Renderer`.

    Raises:
        MapError: the argument is neither a map nor the folder of one.
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
                "a Localizer needs a Map, not a splat alone: gscpe.build_map makes one from a "
                "splat and its photos, gscpe.map_without_references(scene) one that needs prior "
                "poses"
            )
        if not isinstance(settings, LocalizerSettings | None):
            raise SettingsError(
                f"a Localizer's settings must be LocalizerSettings, not a {type(settings).__name__}"
            )
        map_ = map_ if isinstance(map_, Map) else open_map(map_)
        self.map = map_
        self.settings = settings or LocalizerSettings()
        matchers = Matchers(matcher, followed=self.settings.escalate)
        self._matcher = matchers.first.matcher
        self._places = Places(map_, self.settings)
        self._renderer = Renderer(map_.scene, backend, progress)
        self._beside = Beside(self._matcher)
        stages = Stages(map_.frame, self.settings, self._renderer, self._beside)
        references = len(map_.references)
        self._chain = Chain(self.settings, matchers, self._places, stages, references)
        self._unknown_cameras = UnknownCameras(
            map_.references, self.settings, self._renderer, self._matcher, self._places, self._chain
        )
        self._lock = threading.RLock()  # an observer may render
        self._closed = False
        self._process = os.getpid()

    @contextmanager
    def _while_open(self) -> Iterator[None]:
        """One thread at a time.

        Raises:
            ClosedError: the localizer is closed, or was left behind by a fork.
        """
        if os.getpid() != self._process:  # its threads stayed behind, and would be waited for
            raise ClosedError(
                "this localizer was made before its process was forked, and does not survive that: "
                "make one in each process (gscpe.batch starts them)"
            )
        with self._lock, one_blas_thread():
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
            prior: approximate pose of the camera; or the result of the previous frame, which is
                ignored if that was not localized. A precise prior skips retrieval and the coarse
                stage, an imprecise one skips retrieval, and with a position alone, references near
                it are tried first. If this fails, the photo is localized as without a prior.
            references: names of reference photos to start from, most similar first, instead of
                retrieval.
            observer: its methods are called at each step.

        Raises:
            PhotoError: shape or dtype of the image is wrong.
            CameraError: the camera has another image size, or is not a Camera.
            PoseError: the prior has another type.
            MapError: the map has no references, and there is no prior pose; or ``references``
                names one that it does not have.
            RenderError: rendering failed.
            ModelError: a trained network failed.
            ClosedError: the localizer is closed.
        """
        with self._while_open():
            return self._localize(image, camera, prior, references, observer)

    def _localize(
        self,
        image: UInt8Array,
        camera: Camera,
        prior: PosePrior | LocalizationResult | None,
        references: Sequence[str] | None,
        told: Observer | None,
    ) -> LocalizationResult:
        if not isinstance(camera, Camera):
            raise CameraError("localize needs a Camera; Localizer.estimate_camera finds one")
        frame = self.map.frame
        observer = Observer() if told is None else InWorld(told, frame)
        if isinstance(prior, LocalizationResult):
            prior = self._prior_of(prior)
        if not isinstance(prior, PosePrior | None):
            raise PoseError(
                f"a prior must be a PosePrior or a result, not a {type(prior).__name__}"
            )
        if isinstance(references, str):
            raise MapError(f"references must be a list of names: give [{references!r}]")
        if references is not None and not len(references):
            raise MapError("references is empty: name some, or leave it out to have them found")
        knows_rotation = prior is not None and self._places.knows_rotation(prior)
        if not knows_rotation and not len(self.map.references):
            raise MapError(
                "this map has no reference photos to recognize a place by: give a prior pose, or "
                "build it with references"
            )
        if prior is not None:
            prior = prior_in_map(prior, frame)
        clock = Clock()
        photo = self.at_the_maps_resolution(to_photo(image, camera))
        query = self._chain.prepared(photo, clock)
        attempts: list[Attempt] = []
        too_small = _too_small(camera)
        tries = () if too_small else self._chain.attempts(query, prior, references, observer)
        for attempt in tries:
            observer.attempted(attempt)
            attempts.append(attempt)
            best = max(attempts, key=Attempt.rank)
            if best.doubt is None and (self._chain.is_sure(best) or best.orientation != 1):
                break
        result = LocalizationResult.of(attempts, camera, frame, self.settings, clock.seconds())
        return (
            result if result.localized else result.because(too_small or trouble_with_light(photo))
        )

    def _prior_of(self, result: LocalizationResult) -> PosePrior | None:
        """The result of the frame before says where the camera was, some centimetres ago."""
        if result.cam_from_world is None:
            return None
        return PosePrior(
            result.cam_from_world,
            self.settings.motion_sigma / self.map.frame.scale,
            self.settings.motion_sigma_degrees,
        )

    def estimate_camera(
        self, image: UInt8Array | list[UInt8Array], guess: Camera | None = None
    ) -> Camera:
        """The camera of a photo whose intrinsics are not known, for :meth:`localize`, from matches
        with renders: its focal length; and as far as they tell, the ratio of its focal lengths, its
        principal point and the radial distortion of its lens, k1. It knows how sure it is
        (``Camera.covariance``).

        Args:
            image: (H, W, 3) uint8 RGB, not OpenCV's BGR; or several photos that one camera took
                with one setting of its zoom, all of one size, which tell more.
            guess: for example :func:`gscpe.camera_from_exif`; None: an ordinary lens, and the
                principal point in the middle.

        Raises:
            CameraError: the camera cannot be estimated; the message says why.
            PhotoError, MapError, RenderError, ModelError, ClosedError: as :meth:`localize`.
        """
        images: list[Any] = list(image) if isinstance(image, (list, tuple)) else [image]
        with self._while_open():
            return self._unknown_cameras.estimate(images, guess)

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """The map as a camera sees it; as :meth:`gscpe.render.Renderer.render`. The pose,
        (4, 4), and depths are with respect to the world."""
        cam_from_world = check_transform(cam_from_world, "cam_from_world")
        if self._closed:
            raise ClosedError("this localizer is closed")
        # Not one call at a time: who follows a camera need not wait until a photo is localized.
        view = self._renderer.render(camera, self.map.frame.cam_from_map(cam_from_world))
        return view_in_world(view, self.map.frame)

    def match_at(self, image: UInt8Array, camera: Camera, cam_from_world: Float64Array) -> Attempt:
        """Matches a photo with one render, from a pose near its own: one round of the coarse
        stage, to see whether a pose that came from elsewhere is right.

        Args:
            image, camera: as :meth:`localize`.
            cam_from_world: (4, 4), where the render is made.

        Returns:
            An attempt that ends after its coarse stage; its ``doubt`` says whether the matches
            can be trusted.

        Raises:
            PhotoError, CameraError, RenderError, ModelError, ClosedError: as :meth:`localize`.
            PoseError: the pose is not a rigid transform.
        """
        cam_from_world = check_transform(cam_from_world, "cam_from_world")
        frame = self.map.frame
        with self._while_open():
            photo = self.at_the_maps_resolution(to_photo(image, camera))
            start = Start("prior", frame.cam_from_map(cam_from_world))
            coarse = estimate_coarse_pose(
                self._renderer,
                self._matcher,
                self._matcher.prepare(photo.rgb, photo.valid),
                photo.camera,
                start.cam_from_world,
                replace(self.settings.coarse, max_rounds=1),
            )
            doubt = doubt_about_coarse(coarse, photo.camera, self.settings.verification)
        return attempt_in_world(Attempt(start, coarse, None, doubt), frame)

    @property
    def renderer_description(self) -> str:
        """What renders: the OpenGL driver, or the CPU rasterizer and its threads."""
        return self._renderer.description

    def at_the_maps_resolution(self, photo: Photo) -> Photo:
        """The photo as it is localized: with as many pixels per radian as the references have.

        A splat looks right at the resolution of the photos that it was made of: nearer by, its
        Gaussians come apart; from afar, they cover each other.
        """
        scale = self.scale_to_the_map(photo.camera)
        return photo if scale == 1.0 else resized_photo(photo, scale)

    def scale_to_the_map(self, camera: Camera) -> float:
        """Times by which a photo of this pinhole camera is resized before it is localized."""
        references = self.map.references.cameras
        if not references:
            return 1.0
        theirs = float(np.median([camera.without_distortion().fx for camera in references]))
        scale = min(theirs / camera.fx, self.settings.most_enlarged)
        same = self.settings.same_resolution
        return 1.0 if 1.0 / same <= scale <= same else scale

    def close(self) -> None:
        """Releases the renderer's memory, after the current call is finished; the localizer cannot
        be used afterwards."""
        with self._lock:
            self._closed = True
            self._beside.close()
            self._renderer.close()


def _too_small(camera: Camera) -> str | None:
    """Says that a photo is too small: errors of a whole pixel, which no residual shows, are then
    more than the covariance tells."""
    if min(camera.width, camera.height) >= _LEAST_SIDE:
        return None
    return (
        f"the photo has only {camera.width}x{camera.height} pixels; {_LEAST_SIDE} are needed on "
        "its shorter side"
    )
