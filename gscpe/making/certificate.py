# SPDX-License-Identifier: Apache-2.0
"""How good a map is, by photos that it was not made of: numbers, a verdict, and its file."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Sequence, TypeAlias

import numpy as np

from gscpe.errors import MapError, SettingsError
from gscpe.evaluation.text import degrees_text, length_text
from gscpe.given import parse_json
from gscpe.making.settings import CertificateSettings
from gscpe.output_file import write_file
from gscpe.scene.map_folder import CERTIFICATE

Verdict: TypeAlias = Literal["good", "usable", "poor"]

_VERSION = 1

_OF_PHOTOS: dict[Verdict, str] = {
    "good": "It can be relied on for photos like these.",
    "usable": "Most photos will be found; for better ones, train longer (--minutes), and "
    "take more photos, closer to each other and sharp.",
    "poor": "Do not rely on it. Take more photos, half a step apart, sharp and in even "
    "light, and train longer (--minutes).",
}
_OF_RENDERS: dict[Verdict, str] = {
    "good": "Photos from between the viewpoints will mostly be found; whether people take theirs "
    "there, only photos can tell.",
    "usable": "Some photos will not be found.",
    "poor": "Do not rely on it: look at the viewpoints (gscpe view), and give --up and --camera, "
    "or build the map with photos and their poses (--colmap, --images).",
}


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
        of_renders: the "photos" are renders, made worse, from poses beside virtual references:
            the map was made of no photo.
        seen: of a map that was made of no photo, the share of its Gaussians that enough references
            show; None of other maps.
    """

    photos: tuple[CertifiedPhoto, ...]
    scene_size: float
    metres_per_unit: float | None
    learned: int
    gaussians: int
    settings: CertificateSettings
    of_renders: bool = False
    seen: float | None = None

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
        for verdict, localized, error, degrees, seen in (
            ("good", s.good_localized, s.good_error, s.good_degrees, s.good_seen),
            ("usable", s.usable_localized, s.usable_error, s.usable_degrees, s.usable_seen),
        ):
            if (
                self.localized >= localized
                and (self.seen is None or self.seen >= seen)
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
        what = "render" if self.of_renders else "photo"
        left_out = "from beside its viewpoints" if self.of_renders else "that it was not made of"
        measured = (
            f"{found} of the {count} {what}s {left_out} are localized"
            if count > 1
            else f"the {what} {left_out} is {'' if found else 'not '}localized"
        )
        if found:
            whence = (
                "they were rendered" if self.of_renders else "structure from motion placed them"
            )
            measured += (
                f", typically {self.length(self.median_distance)} "
                f"({100 * self.relative_error:.2g}% of the scene's size) and "
                f"{degrees_text(self.median_degrees)} from where {whence}"
            )
        if self.seen is not None:
            measured += (
                f"; its viewpoints show {100 * self.seen:.0f}% of what the splat holds, and photos "
                "of the rest may not be found"
            )
        advice = _OF_RENDERS if self.of_renders else _OF_PHOTOS
        text = f"The map is {self.verdict}: {measured}. {advice[self.verdict]}"
        if count < 5:
            text += f" But {count} {what}{'s' * (count > 1)} left out say little."
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


def write_certificate(map_folder: str | Path, certificate: Certificate) -> None:
    """Writes ``certificate.json`` into the folder of a map.

    Raises:
        OutputError: it cannot be written.
    """
    write_file(Path(map_folder) / CERTIFICATE, certificate.to_json().encode())


def read_certificate(map_folder: str | Path) -> Certificate | None:
    """The certificate of a map; None where it has none.

    Raises:
        MapError: it is damaged.
    """
    path = Path(map_folder) / CERTIFICATE
    if not path.exists():
        return None
    try:
        data = parse_json(path.read_text(encoding="utf-8"))
        return Certificate(
            photos=tuple(CertifiedPhoto(**photo) for photo in data["photos"]),
            scene_size=float(data["scene_size"]),
            metres_per_unit=data["metres_per_unit"],
            learned=int(data["learned"]),
            gaussians=int(data["gaussians"]),
            settings=CertificateSettings(**data["settings"]),
            of_renders=bool(data.get("of_renders", False)),
            seen=None if data.get("seen") is None else float(data["seen"]),
        )
    except (OSError, ValueError, KeyError, TypeError, SettingsError) as error:
        raise MapError(f"{path} is damaged; delete it, or make the map again") from error


def _median(values: Sequence[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else float("nan")


def _or_null(value: float) -> float | None:
    return value if np.isfinite(value) else None
