# SPDX-License-Identifier: Apache-2.0
"""A photo beside the map, as it was localized: photo, render and their difference."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Mapping

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.batch import result_details
from gscpe.geometry.camera import Camera
from gscpe.localization import LocalizationResult, Localizer
from gscpe.photos import Photo, to_photo, to_uint8
from gscpe.poses.hloc import parse_pose
from gscpe.render import RenderedView
from gscpe.render.pictures import Panel, difference_picture, montage
from gscpe.report.encode import data_uri
from gscpe.scene.query_list import Query

_WIDTH = 640  # pixels of a picture in a strip, at most
_BOOST = 4.0
_QUALITY = 85
_LETTER = 8.5  # pixels of a caption


@dataclass(frozen=True, eq=False)
class Comparison:
    """A photo and the map rendered where it was taken.

    Attributes:
        photo: without lens distortion, at the map's resolution.
        view: the map at the pose, of the same size; None where no pose was found at all.
        trusted: whether the photo was localized.
        reason: why not, or None.
        gain, bias: of the render, by which its light is that of the photo.
    """

    photo: Photo
    view: RenderedView | None
    trusted: bool
    reason: str | None
    gain: float
    bias: float

    def difference(self, boost: float = _BOOST) -> UInt8Array | None:
        """See :func:`gscpe.render.pictures.difference_picture`; None without a render."""
        if self.view is None:
            return None
        return difference_picture(self.photo.rgb, self.view, self.gain, self.bias, boost)

    def strip(self) -> UInt8Array:
        """Photo, render and difference side by side under their titles, (H, W, 3) uint8."""
        rgb = self.photo.rgb
        reason = "" if self.reason is None else f"not localized: {self.reason}"
        width = min(_WIDTH, rgb.shape[1])
        panels: list[Panel] = [("photo", rgb, _broken(reason, int(width / _LETTER)))]
        if self.view is not None:
            title = "render at its pose" if self.trusted else "render, at a pose not trusted"
            difference = self.difference()
            assert difference is not None
            panels.append((title, to_uint8(self.view.rgb), ""))
            panels.append((f"difference, {_BOOST:g} times", difference, ""))
        return montage([panels], width)


@dataclass(frozen=True, eq=False)
class ShownResult:
    """A result with its pictures, for a notebook: the last line of a cell shows it.

    Attributes:
        result: of the photo.
        picture: photo, render and difference side by side, (H, W, 3) uint8.
    """

    result: LocalizationResult
    picture: UInt8Array

    def __repr__(self) -> str:
        return repr(self.result)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        alt = "photo, render and their difference"
        image = f'<img src="{data_uri(self.picture, _QUALITY)}" alt="{escape(alt)}">'
        return f"{self.result._repr_html_()}{image}"


def show(result: LocalizationResult, image: UInt8Array, localizer: Localizer) -> ShownResult:
    """A result with photo, render and their difference, as a notebook shows them.

    Args:
        result: of the photo.
        image: the photo that was localized, as :meth:`Localizer.localize` takes it.
        localizer: that did it, still open: the map is rendered.

    Raises:
        PhotoError, CameraError: the photo is not of the result's camera.
        RenderError: rendering failed, or the localizer is closed.
    """
    detail = result_details(Query("photo", result.camera), result)
    return ShownResult(result, compare(detail, image, result.camera, localizer).strip())


def compare(
    detail: Mapping[str, Any], image: UInt8Array, camera: Camera, localizer: Localizer
) -> Comparison:
    """A photo and the map at the best pose that is known of it.

    Args:
        detail: what is known of it (docs/formats.md).
        image: its pixels.
        camera: that took them.
        localizer: with the map.

    Raises:
        PhotoError, CameraError: the image does not fit its camera.
        RenderError: rendering failed.
    """
    photo = localizer.at_the_maps_resolution(to_photo(image, camera))
    pose = shown_pose(detail)
    aligned = detail["aligned"] or {}
    gain, bias = aligned.get("gain"), aligned.get("bias")
    return Comparison(
        photo,
        None if pose is None else localizer.render(photo.camera, pose),
        detail["status"] == "localized",
        detail["reason"],
        1.0 if gain is None else float(gain),
        0.0 if bias is None else float(bias),
    )


def shown_pose(detail: Mapping[str, Any]) -> Float64Array | None:
    """Where a query is shown from: its final pose; where it was not localized, the last pose
    that was found and not trusted, coarse before aligned; None where there is none."""
    for source in (detail, detail["coarse"], detail["aligned"]):
        if source is not None and source["cam_from_world"] is not None:
            return parse_pose(source["cam_from_world"])
    return None


def strip_path(folder: Path, name: str) -> Path:
    """Where the strip of a photo is written: under its name, inside of the folder whatever the
    name is."""
    parts = [part for part in Path(name.replace("\\", "/")).parts if part not in ("/", "..")]
    path = folder.joinpath(*parts)
    return path if path.suffix.lower() == ".png" else path.with_name(path.name + ".png")


def _broken(text: str, letters: int) -> str:
    """In lines of at most so many letters, as far as words allow."""
    lines, line = [], ""
    for word in text.split():
        if line and len(line) + len(word) >= letters:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}".strip()
    return "\n".join([*lines, line] if line else lines)
