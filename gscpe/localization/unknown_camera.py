# SPDX-License-Identifier: Apache-2.0
"""Cameras whose intrinsics nobody wrote down: they are estimated from matches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Sequence

import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.coarse import (
    CameraEstimate,
    CoarseSettings,
    IntrinsicsSettings,
    estimate_intrinsics,
    lift,
    probable_camera,
)
from gscpe.errors import CameraError, MapError
from gscpe.geometry.camera import Camera
from gscpe.localization.chain import Chain
from gscpe.localization.clock import Clock
from gscpe.localization.light import trouble_with_light
from gscpe.localization.places import Places
from gscpe.localization.prepared import PreparedPhoto
from gscpe.localization.result import NO_FEATURES
from gscpe.localization.settings import LocalizerSettings
from gscpe.localization.starts import Start
from gscpe.localization.turns import estimate_turned_back
from gscpe.matching import Matcher
from gscpe.photos import Photo, to_photo, to_uint8
from gscpe.photos.image_array import check_image
from gscpe.photos.photo import resized_photo
from gscpe.render import Renders
from gscpe.scene import References


@dataclass(frozen=True)
class UnknownCameras:
    """Estimates cameras from photos of a map's place; see :meth:`gscpe.Localizer.estimate_camera`.

    Attributes:
        references: of the map.
        settings: of the localizer.
        renderer: of the map's splat.
        matcher: of photo and render.
        places: where to begin.
        chain: turns photos where they are not recognized.
    """

    references: References
    settings: LocalizerSettings
    renderer: Renders
    matcher: Matcher
    places: Places
    chain: Chain

    def estimate(self, images: Sequence[UInt8Array], guess: Camera | None) -> Camera:
        """The camera that took one or several (H, W, 3) photos of one size.

        Args:
            images: uint8 RGB. One from which it cannot be estimated is left out, unless none is
                left.
            guess: None: an ordinary lens.

        Raises:
            CameraError: the camera cannot be estimated, or the photos have several sizes.
            MapError: the map has no references.
            PhotoError, RenderError, ModelError: as :meth:`gscpe.Localizer.localize`.
        """
        if not len(self.references):
            raise MapError(
                "a focal length cannot be estimated with a map without reference photos; give "
                "the camera"
            )
        if not isinstance(guess, Camera | None):
            raise CameraError(f"the guess must be a Camera or None, not a {type(guess).__name__}")
        images = [check_image(image, transparent=True) for image in images]
        if len({image.shape[:2] for image in images}) != 1:
            raise CameraError("one camera is estimated from one photo or more, all of one size")
        guess = guess or ordinary_camera(images[0], self.settings.intrinsics)
        if guess.fisheye:
            raise CameraError("a fisheye cannot be estimated: give its camera")
        found, reason = list[CameraEstimate](), ""
        for image in images:
            photo = self._resized(to_photo(image, guess))
            estimate = self._of_photo(photo)
            if isinstance(estimate, str):
                reason = trouble_with_light(photo) or estimate
            else:
                found.append(estimate)
        if not found:
            raise CameraError(f"the camera's focal length cannot be estimated: {reason}")
        resized = guess.resized(photo.camera.width, photo.camera.height)
        camera = probable_camera(resized, found, self.settings.intrinsics)
        return camera.resized(guess.width, guess.height)

    def _of_photo(self, photo: Photo) -> CameraEstimate | str:
        query = PreparedPhoto(photo, self.matcher, Clock())
        reason = NO_FEATURES
        for start in islice(self.places.starts(query), self.settings.hypotheses):
            estimate = self._from(query, start)
            if isinstance(estimate, CameraEstimate):
                return estimate
            reason = estimate
        for turned in self.chain.turned(query):
            for start in self.chain.turned_starts(turned):
                estimate = self._from(turned, start)
                if isinstance(estimate, CameraEstimate):
                    return estimate_turned_back(estimate, turned.orientation)
        return reason

    def _from(self, query: PreparedPhoto, start: Start) -> CameraEstimate | str:
        assert start.reference is not None
        index = self.references.names.index(start.reference)
        return estimate_camera(
            self.renderer,
            self.matcher,
            query.for_matching,
            query.photo.camera,
            start.cam_from_world,
            self.references.cameras[index].without_distortion(),
            self.settings.coarse,
            self.settings.intrinsics,
        )

    def _resized(self, photo: Photo) -> Photo:
        longer_side = max(photo.camera.width, photo.camera.height)
        larger = min(self._reference_side() / longer_side, self.settings.most_enlarged)
        return resized_photo(photo, larger)

    def _reference_side(self) -> float:
        """The longer side of a typical reference photo, in pixels."""
        cameras = self.references.cameras
        return float(np.median([max(camera.width, camera.height) for camera in cameras]))


def ordinary_camera(image: UInt8Array, settings: IntrinsicsSettings) -> Camera:
    """A guess for an (H, W, 3) image of which nothing is known."""
    height, width = image.shape[:2]
    focal = settings.ordinary * max(height, width)
    return Camera.pinhole(width, height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)


def estimate_camera(
    renderer: Renders,
    matcher: Matcher,
    prepared_photo: Any,
    guess: Camera,
    start_cam_from_world: Float64Array,
    start_camera: Camera,
    coarse: CoarseSettings,
    settings: IntrinsicsSettings,
) -> CameraEstimate | str:
    """Pose and camera of a photo; a string says why they cannot be told.

    Two rounds: with a render of the reference as its own camera saw it, then with one from
    where the photo was taken.

    Args:
        renderer: of the map's splat.
        matcher: which prepared the photo.
        prepared_photo: ``matcher.prepare(photo)``.
        guess: pinhole camera of the photo.
        start_cam_from_world: (4, 4), the reference pose.
        start_camera: pinhole camera of the reference.
        coarse: thresholds of matches.
        settings: see :class:`gscpe.coarse.IntrinsicsSettings`.
    """
    estimate: CameraEstimate | None = None
    view = renderer.render(start_camera, start_cam_from_world)
    near = replace(settings, widest=1 / settings.around, narrowest=settings.around, steps=3)
    for bounds in (settings, near):
        if estimate is not None:
            seen_by = estimate.camera.without_distortion()
            view = renderer.render(seen_by, estimate.cam_from_world)
        seen = view.opacity >= coarse.min_opacity
        matches = matcher.match(prepared_photo, matcher.prepare(to_uint8(view.rgb), seen))
        points_world, liftable = lift(view, matches.render_pixels, coarse.min_opacity)
        found = estimate_intrinsics(
            points_world[liftable],
            matches.photo_pixels[liftable],
            guess,
            coarse.pnp,
            bounds,
            None if estimate is None else estimate.change,
        )
        if isinstance(found, str):
            return found
        estimate = found
    assert estimate is not None
    return estimate
