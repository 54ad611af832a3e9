# SPDX-License-Identifier: Apache-2.0
"""How good a map is: photos that it was not made of are localized in it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Sequence, TypeAlias

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float32Array, Float64Array
from gscpe.errors import MapError
from gscpe.evaluation.text import degrees_text, length_text
from gscpe.geometry.pose_error import camera_centres, pose_difference
from gscpe.localization import Localizer
from gscpe.making.settings import CertificateSettings
from gscpe.photos import Photo, read_image_of, to_photo
from gscpe.scene import Map, References
from gscpe.scene.map_folder import CERTIFICATE

Verdict: TypeAlias = Literal["good", "usable", "poor"]

_VERSION = 1


@dataclass(frozen=True)
class CertifiedPhoto:
    """A photo that the map was not made of.

    Attributes:
        name: of it.
        reason: why it was not localized; None where it was.
        distance: of its position from where it was placed, world units; None without a pose.
        degrees: between both rotations.
        psnr: of photo and render at the pose where it was placed, dB.
        fitted_psnr: with a gain and a bias fitted to each channel: exposure does not count.
        ssim: structural similarity, as psnr.
    """

    name: str
    reason: str | None
    distance: float | None
    degrees: float | None
    psnr: float
    fitted_psnr: float
    ssim: float


@dataclass(frozen=True)
class Certificate:
    """What came of the photos that were left out.

    Attributes:
        photos: each of them.
        scene_size: the largest distance between two photos, or the median distance of what they
            show, whichever is more; world units.
        metres_per_unit: None where it is not known.
        learned: number of photos that the map is made of.
        gaussians: of the map.
        settings: that the verdict is by.
    """

    photos: tuple[CertifiedPhoto, ...]
    scene_size: float
    metres_per_unit: float | None
    learned: int
    gaussians: int
    settings: CertificateSettings

    @property
    def localized(self) -> float:
        """Share of the photos, in [0, 1]."""
        return sum(photo.reason is None for photo in self.photos) / len(self.photos)

    @property
    def median_distance(self) -> float:
        """Of the localized ones, world units; NaN where there is none."""
        return _median([photo.distance for photo in self.photos])

    @property
    def median_degrees(self) -> float:
        """Of the localized ones; NaN where there is none."""
        return _median([photo.degrees for photo in self.photos])

    @property
    def relative_error(self) -> float:
        """Median distance as a share of the scene's size."""
        return self.median_distance / self.scene_size

    def within(self, share: float) -> float:
        """Share of all photos that are localized within this share of the scene's size."""
        near = [
            p.distance is not None and p.distance <= share * self.scene_size for p in self.photos
        ]
        return sum(near) / len(near)

    @property
    def verdict(self) -> Verdict:
        """By :class:`CertificateSettings`."""
        s = self.settings
        for verdict, localized, error, degrees in (
            ("good", s.good_localized, s.good_error, s.good_degrees),
            ("usable", s.usable_localized, s.usable_error, s.usable_degrees),
        ):
            if (
                self.localized >= localized
                and self.relative_error <= error
                and self.median_degrees <= degrees
            ):
                return "good" if verdict == "good" else "usable"
        return "poor"

    @property
    def length_unit(self) -> float:
        """Metres in a world unit, or 1 where that is not known."""
        return self.metres_per_unit or 1.0

    def length(self, distance: float) -> str:
        """A distance in world units, for people."""
        return length_text(distance * self.length_unit, self.metres_per_unit is not None)

    def explanation(self) -> str:
        """The verdict in plain words."""
        count = len(self.photos)
        found = sum(photo.reason is None for photo in self.photos)
        measured = (
            f"{found} of the {count} photos that it was not made of are localized"
            if count > 1
            else f"the photo that it was not made of is {'' if found else 'not '}localized"
        )
        if found:
            measured += (
                f", typically {self.length(self.median_distance)} "
                f"({100 * self.relative_error:.2g}% of the scene's size) and "
                f"{degrees_text(self.median_degrees)} from where structure from motion placed them"
            )
        advice = {
            "good": "It can be relied on for photos like these.",
            "usable": "Most photos will be found; for better ones, train longer (--minutes), and "
            "take more photos, closer to each other and sharp.",
            "poor": "Do not rely on it. Take more photos, half a step apart, sharp and in even "
            "light, and train longer (--minutes).",
        }
        text = f"The map is {self.verdict}: {measured}. {advice[self.verdict]}"
        if count < 5:
            text += f" But {count} photo{'s' * (count > 1)} left out say little."
        return text

    def worst_first(self) -> list[CertifiedPhoto]:
        """Those that were not localized, then by falling error."""
        return sorted(
            self.photos, key=lambda p: (p.distance is not None, -(p.distance or 0.0), p.name)
        )

    def mean(self, what: Literal["psnr", "fitted_psnr", "ssim"]) -> float:
        """Over all photos."""
        return float(np.mean([getattr(photo, what) for photo in self.photos]))

    def to_json(self) -> str:
        """For ``certificate.json`` in the map's folder."""
        data: dict[str, Any] = asdict(self)
        data = {
            "format": "gscpe certificate",
            "version": _VERSION,
            "verdict": self.verdict,
            "localized": self.localized,
            "median_distance": _or_null(self.median_distance),
            "relative_error": _or_null(self.relative_error),
            "median_degrees": _or_null(self.median_degrees),
            **{name: self.mean(name) for name in ("psnr", "fitted_psnr", "ssim")},
            **data,
        }
        return json.dumps(data, indent=1, allow_nan=False) + "\n"


def certify(
    map_: Map,
    left_out: References,
    image_folder: str | Path,
    settings: CertificateSettings | None = None,
    backend: str = "auto",
    matcher: str | None = None,
    progress: bool = False,
) -> tuple[Certificate, dict[str, tuple[Float32Array, Float32Array]]]:
    """Localizes photos that a map was not made of.

    Args:
        map_: to localize in.
        left_out: names, cameras and poses of the photos, in the world of the map.
        image_folder: where they are.
        settings: of the verdict, and how many pictures there are to be.
        backend, matcher: as :class:`gscpe.Localizer`.
        progress: show a bar.

    Returns:
        The certificate, and photo and render, (H, W, 3) in [0, 1], of the worst photos and of some
        others, by name.

    Raises:
        MapError: there are no such photos.
        PhotoError, CameraError: one cannot be used.
    """
    settings = settings or CertificateSettings()
    if not len(left_out):
        raise MapError("a certificate needs photos that the map was not made of")
    photos: list[CertifiedPhoto] = []
    images: dict[str, tuple[Float32Array, Float32Array]] = {}
    depths: list[float] = []
    with Localizer(map_, matcher=matcher, backend=backend, progress=progress) as localizer:
        for name, pose, camera in tqdm(
            list(zip(left_out.names, left_out.cam_from_world, left_out.cameras, strict=True)),
            desc="certifying the map",
            unit="photo",
            disable=not progress,
        ):
            image = read_image_of(Path(image_folder) / name, camera)
            result = localizer.localize(image, camera)
            photo = localizer.at_the_maps_resolution(to_photo(image, camera))
            view = localizer.render(photo.camera, pose)
            if np.any(view.depth > 0):
                depths.append(float(np.median(view.depth[view.depth > 0])))
            shown = np.clip(view.rgb, 0.0, 1.0)
            truth = photo.rgb.astype(np.float32) / np.float32(255.0)
            images[name] = truth, shown
            distance = degrees = None
            if result.cam_from_world is not None:
                off = pose_difference(result.cam_from_world, pose)
                distance, degrees = float(off.distance), float(off.degrees)
            likeness = _likeness(photo, truth, shown)
            photos.append(CertifiedPhoto(name, result.reason, distance, degrees, *likeness))
    certificate = Certificate(
        photos=tuple(photos),
        scene_size=_scene_size(map_.world_references.cam_from_world, left_out, depths),
        metres_per_unit=map_.metres_per_unit,
        learned=len(map_.references),
        gaussians=len(map_.scene),
        settings=settings,
    )
    kept = _to_show([photo.name for photo in certificate.worst_first()], settings.pictures)
    return certificate, {name: images[name] for name in kept}


def read_certificate(map_folder: str | Path) -> Certificate | None:
    """The certificate of a map; None where it has none.

    Raises:
        MapError: it is damaged.
    """
    path = Path(map_folder) / CERTIFICATE
    if not path.exists():
        return None
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return Certificate(
            photos=tuple(CertifiedPhoto(**photo) for photo in data["photos"]),
            scene_size=float(data["scene_size"]),
            metres_per_unit=data["metres_per_unit"],
            learned=int(data["learned"]),
            gaussians=int(data["gaussians"]),
            settings=CertificateSettings(**data["settings"]),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MapError(f"{path} is damaged ({error}); delete it, or make the map again") from error


def _likeness(photo: Photo, truth: Float32Array, shown: Float32Array) -> tuple[float, float, float]:
    """PSNR as it is and with exposure fitted, and SSIM (Wang et al., 2004), of what is valid."""
    from skimage.metrics import structural_similarity

    valid = np.ones(truth.shape[:2], dtype=bool) if photo.valid is None else photo.valid
    _, similar = structural_similarity(
        truth, shown, channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    x, y = shown[valid], truth[valid]
    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    covariance = ((x - mean_x) * (y - mean_y)).mean(axis=0)
    gain = covariance / np.maximum(((x - mean_x) ** 2).mean(axis=0), 1e-9)
    fitted = np.clip(gain * (x - mean_x) + mean_y, 0.0, 1.0)
    return _psnr(x, y), _psnr(fitted, y), float(np.mean(similar[valid]))


def _psnr(x: Float32Array, y: Float32Array) -> float:
    return -10.0 * float(np.log10(max(float(np.mean((x - y) ** 2)), 1e-10)))


def _scene_size(learned: Float64Array, left_out: References, depths: Sequence[float]) -> float:
    poses = np.concatenate([learned, left_out.cam_from_world])
    centres = camera_centres(poses)
    apart = max(float(np.linalg.norm(centres - centre, axis=1).max()) for centre in centres)
    return max(apart, float(np.median(depths)) if depths else 0.0, 1e-12)


def _to_show(worst_first: Sequence[str], count: int) -> list[str]:
    """The worst half, and of the others every so many; in this order."""
    if len(worst_first) <= count:
        return list(worst_first)
    worst = (count + 1) // 2
    rest = worst_first[worst:]
    chosen = np.unique(np.linspace(0, len(rest) - 1, count - worst).round().astype(int))
    return [*worst_first[:worst], *(rest[i] for i in chosen)]


def _median(values: Sequence[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else float("nan")


def _or_null(value: float) -> float | None:
    return value if np.isfinite(value) else None
