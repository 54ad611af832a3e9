# SPDX-License-Identifier: Apache-2.0
"""One photo, of a known camera or not, and its answer as JSON: what ``gscpe localize --json``
prints and the service (gscpe.service) answers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gscpe.arrays import UInt8Array
from gscpe.batch.details import Detail, failed_details, result_details
from gscpe.errors import CameraError
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.localization import LocalizationResult, Localizer, Observer, PosePrior
from gscpe.photos.exif import exif_camera
from gscpe.photos.image_file import decode_image, decode_image_of
from gscpe.scene.query_list import Query

_NO_CAMERA = Camera.pinhole(1, 1, fx=1.0, fy=1.0, cx=0.5, cy=0.5)


@dataclass(frozen=True, eq=False)
class OnePhoto:
    """A photo that was decoded.

    Attributes:
        name: what messages call it.
        image: (H, W, 3) or (H, W, 4) uint8; upright where the camera is not known, else as the
            camera saw it.
        camera: that was given, or None.
        guess: of the camera, where none was given and EXIF says something.
    """

    name: str
    image: UInt8Array
    camera: Camera | None = None
    guess: Camera | None = None

    @classmethod
    def decode(cls, data: bytes, name: str | Path, camera: Camera | None) -> OnePhoto:
        """Of the bytes of a file.

        Raises:
            PhotoError: they are no image that can be decoded.
            CameraError: the camera has another size.
        """
        if camera is not None:
            return cls(str(name), decode_image_of(data, name, camera), camera)
        image = decode_image(data, name, upright=True)
        return cls(str(name), image, None, exif_camera(data, name, upright=True))


@dataclass(frozen=True, eq=False)
class OneResult:
    """What is known of a photo.

    Attributes:
        name: of the photo.
        camera: that was given or estimated; None where it could not be estimated.
        reason: why the photo was not localized, or None.
        result: of the localizer; None where there is no camera.
    """

    name: str
    camera: Camera | None
    reason: str | None
    result: LocalizationResult | None

    @property
    def localized(self) -> bool:
        """Whether the pose can be trusted."""
        return self.result is not None and self.result.localized

    def as_json(self) -> Detail:
        """Plain data; docs/formats.md says what each field is."""
        if self.result is None or self.camera is None:
            detail = failed_details(Query(self.name, _NO_CAMERA), self.reason or "")
            detail |= {"camera": None, "status": "not localized"}
            attempts, pose = [], None
        else:
            detail = result_details(Query(self.name, self.camera), self.result)
            pose = self.result.cam_from_world
            attempts = [
                {
                    "started_from": attempt.start.kind,
                    "reference": attempt.start.reference,
                    "orientation": attempt.orientation,
                    "matcher": attempt.matcher,
                    "reason": attempt.doubt,
                }
                for attempt in self.result.attempts
            ]
        quaternion, translation = (
            (None, None) if pose is None else se3.to_quaternion_translation(pose)
        )
        return detail | {
            "matrix": None if pose is None else pose.tolist(),
            "quaternion_wxyz": None if quaternion is None else quaternion.tolist(),
            "translation": None if translation is None else translation.tolist(),
            "attempts": attempts,
        }


def localize_one(
    localizer: Localizer,
    photo: OnePhoto,
    prior: PosePrior | None = None,
    observer: Observer | None = None,
) -> OneResult:
    """Localizes a photo; its camera is estimated first where it is not known. One whose camera
    cannot be estimated is not localized, with that reason.

    Raises:
        GscpeError: as :meth:`gscpe.Localizer.localize`.
    """
    camera = photo.camera
    if camera is None:
        try:
            camera = localizer.estimate_camera(photo.image, photo.guess)
        except CameraError as error:
            return OneResult(photo.name, None, str(error), None)
    result = localizer.localize(photo.image, camera, prior, observer=observer)
    return OneResult(photo.name, camera, result.reason, result)
