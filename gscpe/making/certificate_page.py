# SPDX-License-Identifier: Apache-2.0
"""A certificate as one HTML file that needs nothing else, and no network."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Mapping

import cv2
import numpy as np

from gscpe.arrays import Float32Array, UInt8Array
from gscpe.evaluation.text import degrees_text, number_text, share_text
from gscpe.making.certificate import Certificate, CertifiedPhoto
from gscpe.making.certificate_tables import photo_table
from gscpe.output_file import write_file
from gscpe.photos import to_uint8
from gscpe.report.encode import data_uris
from gscpe.report.one_file import filled_page

_BOOST = 2
_QUALITY = 80
_TITLES = ("Photo", "Render", "Difference")


@dataclass(frozen=True)
class _Figure:
    title: str
    uri: str
    width: int
    height: int


@dataclass(frozen=True)
class _Shown:
    name: str
    reason: str | None
    facts: str
    figures: tuple[_Figure, ...]


def write_certificate_page(
    path: str | Path,
    title: str,
    certificate: Certificate,
    images: Mapping[str, tuple[Float32Array, Float32Array]],
    facts: Mapping[str, str] | None = None,
) -> None:
    """Writes the page.

    Args:
        path: of the page.
        title: name of the map.
        certificate: of it.
        images: photo and render, (H, W, 3) in [0, 1], of the photos that are to be shown, by name.
        facts: what else is to be said of the map, names and values.

    Raises:
        OutputError: the page cannot be written.
    """
    s = certificate.settings
    pictures = [
        picture
        for photo, render in images.values()
        for picture in _row(photo, render, s.picture_width)
    ]
    uris = iter(data_uris(pictures, _QUALITY, s.max_bytes))
    sizes = iter(picture.shape[:2] for picture in pictures)
    known = {photo.name: photo for photo in certificate.photos}
    shown = []
    for name in images:
        figures = []
        for what in _TITLES:
            height, width = next(sizes)
            figures.append(_Figure(what, next(uris), width, height))
        photo = known[name]
        shown.append(_Shown(name, photo.reason, _facts(photo, certificate), tuple(figures)))
    text = _filled(
        {
            "title": title,
            "verdict": certificate.verdict,
            "explanation": certificate.explanation(),
            "tiles": _tiles(certificate),
            "facts": tuple((facts or {}).items()),
            "shown": shown,
            "links": {item.name: f"photo-{number}" for number, item in enumerate(shown)},
            "photos": photo_table(certificate),
            "metric": certificate.metres_per_unit is not None,
            "boost": _BOOST,
            "thresholds": (
                f"a good map localizes {share_text(s.good_localized)} of them with a median error "
                f"of at most {100 * s.good_error:g}% of the scene's size and {s.good_degrees:g}°, "
                f"a usable one {share_text(s.usable_localized)} with {100 * s.usable_error:g}% and "
                f"{s.usable_degrees:g}°"
            ),
        }
    )
    write_file(path, text.encode("utf-8", "replace"))


def _row(photo: Float32Array, render: Float32Array, width: int) -> list[UInt8Array]:
    """Photo, render and difference, no wider than this."""
    difference = np.clip(_BOOST * np.abs(photo - render), 0.0, 1.0)
    scale = min(1.0, width / photo.shape[1])
    size = max(1, round(photo.shape[1] * scale)), max(1, round(photo.shape[0] * scale))
    return [
        to_uint8(np.asarray(cv2.resize(each, size, interpolation=cv2.INTER_AREA)))
        for each in (photo, render, difference.astype(np.float32))
    ]


def _facts(photo: CertifiedPhoto, certificate: Certificate) -> str:
    parts = [f"PSNR {number_text(photo.psnr, 1)} dB", f"SSIM {number_text(photo.ssim, 2)}"]
    if photo.distance is not None:
        share = 100 * photo.distance / certificate.scene_size
        parts = [
            f"{certificate.length(photo.distance)} ({share:.2g}% of the scene's size)",
            degrees_text(photo.degrees),
            *parts,
        ]
    return " · ".join(parts)


def _tiles(certificate: Certificate) -> list[tuple[str, str]]:
    found = sum(photo.reason is None for photo in certificate.photos)
    tiles = [(f"{found} / {len(certificate.photos)}", "photos left out are localized")]
    if found:
        tiles += [
            (f"{100 * certificate.relative_error:.2g}%", "of the scene's size: median error"),
            (certificate.length(certificate.median_distance), "their median position error"),
            (degrees_text(certificate.median_degrees), "their median rotation error"),
        ]
    return [
        *tiles,
        (f"{certificate.mean('psnr'):.1f} dB", "PSNR of the renders"),
        (f"{certificate.mean('ssim'):.2f}", "SSIM of the renders"),
    ]


def _filled(values: Mapping[str, object]) -> str:
    making = resources.files("gscpe.making")
    style = "".join(
        folder.joinpath(name).read_text(encoding="utf-8")
        for folder, name in (
            (resources.files("gscpe.report"), "page.css"),
            (making, "certificate.css"),
        )
    )
    template = making.joinpath("certificate.html.jinja").read_text(encoding="utf-8")
    return filled_page(template, values, style)
