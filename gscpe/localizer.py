"""The pipeline: one persistent object, one call a photo."""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Iterator

import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.coarse import CoarseResult, CoarseSettings, estimate_coarse_pose
from gscpe.errors import SettingsError
from gscpe.geometry.camera import Camera
from gscpe.matching import Matcher, SiftMatcher
from gscpe.refinement import RefinementResult, RefinementSettings, refine_pose
from gscpe.render import RenderedView, Renderer
from gscpe.retrieval import (
    RetrievedReference,
    VladSettings,
    describe_image,
    local_descriptors,
    search,
)
from gscpe.scene import Map, Photo, to_photo
from gscpe.scene.photo import resized_photo
from gscpe.verification import VerificationSettings, doubt_about_coarse, doubt_about_refined

_SAME_RESOLUTION = 1.03
"""Focal lengths in pixels within this factor need no resampling of the photo."""

_MOST_ENLARGED = 2.0
"""A photo with fewer pixels is enlarged at most this much: there is nothing more in it."""


@dataclass(frozen=True)
class LocalizerSettings:
    """Settings of every stage.

    Attributes:
        hypotheses: reference photos that are tried, best first, until one is not doubted.
        retrieval: how a query is described; must be what the map was built with.
    """

    hypotheses: int = 3
    retrieval: VladSettings = field(default_factory=VladSettings)
    coarse: CoarseSettings = field(default_factory=CoarseSettings)
    refinement: RefinementSettings = field(default_factory=RefinementSettings)
    verification: VerificationSettings = field(default_factory=VerificationSettings)

    def __post_init__(self) -> None:
        if self.hypotheses < 1:
            raise SettingsError("at least one reference photo must be tried")


@dataclass(frozen=True, eq=False)
class LocalizationResult:
    """Where a photo was taken, or why that is not known.

    Attributes:
        localized: whether the pose can be trusted.
        reason: why not; None when localized.
        cam_from_world: (4, 4) float64, world to camera; None when not localized.
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``, (translation, rotation),
            map units and radians; None when not localized.
        reference: name of the reference photo that the coarse stage started from; None
            when there was none.
        coarse: result of the coarse stage of that reference, trusted or not.
        refined: result of the refinement; None when the coarse pose was not trusted.
        seconds: wall time by stage: retrieval, coarse, refinement, total.
    """

    localized: bool
    reason: str | None
    cam_from_world: Float64Array | None
    covariance: Float64Array | None
    reference: str | None
    coarse: CoarseResult | None
    refined: RefinementResult | None
    seconds: dict[str, float]


class Localizer:
    """Localizes photos in one map. Holds the map on the graphics driver or in memory: keep it,
    use it from one thread at a time, and close it (or use it as a context manager).

    Args:
        map_: to localize in.
        settings: of every stage.
        matcher: of photo and render; SIFT by default.
        backend, progress: as :class:`gscpe.render.Renderer`.

    Raises:
        RenderError: there is nothing to render with.
    """

    def __init__(
        self,
        map_: Map,
        settings: LocalizerSettings | None = None,
        matcher: Matcher | None = None,
        backend: str = "auto",
        progress: bool = False,
    ) -> None:
        self.map = map_
        self.settings = settings or LocalizerSettings()
        self._matcher: Matcher = matcher or SiftMatcher()
        self._renderer = Renderer(map_.scene, backend, progress)

    def localize(self, image: UInt8Array, camera: Camera) -> LocalizationResult:
        """Estimates the pose of a photo.

        Args:
            image: (H, W, 3) uint8 RGB.
            camera: its intrinsics; lens distortion is removed first.

        Raises:
            PhotoError: shape or dtype of the image is wrong.
            CameraError: the camera is of another image size.
            RenderError: OpenGL failed.
        """
        clock = _Clock()
        photo = self._at_the_maps_resolution(to_photo(image, camera))
        with clock.stage("retrieval"):
            retrieved = self._retrieve(photo)
        best: tuple[RetrievedReference, CoarseResult] | None = None
        doubt: str | None = "the photo has no features to recognize a place by"
        with clock.stage("coarse"):
            prepared = self._matcher.prepare(photo.rgb, photo.valid) if retrieved else None
            for reference in retrieved:
                coarse = self._coarse(prepared, photo, reference)
                new_doubt = doubt_about_coarse(coarse, photo.camera, self.settings.verification)
                if best is None or coarse.inliers > best[1].inliers or new_doubt is None:
                    best, doubt = (reference, coarse), new_doubt
                if doubt is None:
                    break
        refined = None
        if best is not None and doubt is None:
            assert best[1].cam_from_world is not None
            unit = self.map.metres_per_unit
            with clock.stage("refinement"):
                refined = refine_pose(
                    self._renderer,
                    photo,
                    best[1].cam_from_world,
                    self.settings.refinement,
                    unit,
                )
            doubt = doubt_about_refined(best[1], refined, self.settings.verification, unit)
        trusted = refined is not None and doubt is None
        return LocalizationResult(
            localized=trusted,
            reason=doubt,
            cam_from_world=refined.cam_from_world if trusted and refined else None,
            covariance=refined.covariance if trusted and refined else None,
            reference=self.map.references.names[best[0].index] if best else None,
            coarse=best[1] if best else None,
            refined=refined,
            seconds=clock.seconds(),
        )

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """The map as a camera sees it; as :meth:`gscpe.render.Renderer.render`."""
        return self._renderer.render(camera, cam_from_world)

    @property
    def renderer_description(self) -> str:
        """What renders: the OpenGL driver, or the CPU rasterizer and its threads."""
        return self._renderer.description

    def _at_the_maps_resolution(self, photo: Photo) -> Photo:
        """A splat looks right at the resolution of the photos that it was made of: nearer by,
        its Gaussians come apart; from afar, they cover each other. Angles a pixel count."""
        references = self.map.references.cameras
        if not references:
            return photo
        theirs = float(np.median([camera.fx for camera in references]))
        scale = min(theirs / photo.camera.fx, _MOST_ENLARGED)
        if 1.0 / _SAME_RESOLUTION <= scale <= _SAME_RESOLUTION:
            return photo
        return resized_photo(photo, scale)

    def _retrieve(self, photo: Photo) -> tuple[RetrievedReference, ...]:
        known = self.map.descriptors
        local = local_descriptors(photo.rgb, self.settings.retrieval)
        query = describe_image(local, known.vocabulary)
        if not np.any(query):
            return ()
        return search(query, known.descriptors, self.settings.hypotheses)

    def _coarse(self, prepared: Any, photo: Photo, reference: RetrievedReference) -> CoarseResult:
        return estimate_coarse_pose(
            self._renderer,
            self._matcher,
            prepared,
            photo.camera,
            self.map.references.cam_from_world[reference.index],
            self.settings.coarse,
            self.map.metres_per_unit,
        )

    def close(self) -> None:
        """Gives the renderer's memory back; the localizer cannot be used after."""
        self._renderer.close()

    def __enter__(self) -> Localizer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class _Clock:
    """Wall time by stage."""

    def __init__(self) -> None:
        self._begin = time.perf_counter()
        self._stages: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        try:
            yield
        finally:
            self._stages[name] = self._stages.get(name, 0.0) + time.perf_counter() - begin

    def seconds(self) -> dict[str, float]:
        return {**self._stages, "total": time.perf_counter() - self._begin}
