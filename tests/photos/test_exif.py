# SPDX-License-Identifier: Apache-2.0
"""A guess of the camera from what it wrote into its photo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from gscpe import camera_from_exif
from gscpe.errors import PhotoError

FOCAL_LENGTH_35MM, FOCAL_LENGTH, ORIENTATION = 0xA405, 0x920A, 0x0112


def photo(path: Path, size: tuple[int, int] = (400, 300), **tags: Any) -> Path:
    """A JPEG with these tags: ``mm35``, ``focal`` and ``orientation``."""
    exif = Image.Exif()
    block = exif.get_ifd(0x8769)
    if "mm35" in tags:
        block[FOCAL_LENGTH_35MM] = tags["mm35"]
    if "focal" in tags:
        block[FOCAL_LENGTH] = tags["focal"]
    if "orientation" in tags:
        exif[ORIENTATION] = tags["orientation"]
    pixels = np.random.default_rng(0).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path, exif=exif)
    return path


@pytest.mark.parametrize("size", [(400, 300), (300, 400), (640, 360)])
@pytest.mark.parametrize("millimetres", [13, 28, 50, 200])
def test_the_35_mm_equivalent(size: tuple[int, int], millimetres: int, tmp_path: Path) -> None:
    """It sees the same angle over the diagonal as that lens does on a 36 x 24 mm film."""
    camera = camera_from_exif(photo(tmp_path / "a.jpg", size, mm35=millimetres))
    assert camera is not None
    assert (camera.width, camera.height) == size
    assert (camera.cx, camera.cy) == (size[0] / 2, size[1] / 2)
    assert camera.is_pinhole
    assert camera.fx == camera.fy
    angle = 2 * np.degrees(np.arctan(0.5 * np.hypot(*size) / camera.fx))
    film = 2 * np.degrees(np.arctan(0.5 * np.sqrt(36.0**2 + 24.0**2) / millimetres))
    assert angle == pytest.approx(film, abs=1e-9)


def test_a_known_angle(tmp_path: Path) -> None:
    """A 50 mm lens sees 46.8 degrees over the diagonal, as every catalogue says."""
    camera = camera_from_exif(photo(tmp_path / "a.jpg", (600, 400), mm35=50))
    assert camera is not None
    angle = 2 * np.degrees(np.arctan(0.5 * np.hypot(600, 400) / camera.fx))
    assert angle == pytest.approx(46.8, abs=0.05)


def test_as_stored(tmp_path: Path) -> None:
    """Like read_image: a photo to be shown turned has the camera of its stored pixels."""
    camera = camera_from_exif(photo(tmp_path / "a.jpg", (400, 300), mm35=28, orientation=6))
    assert camera is not None
    assert (camera.width, camera.height) == (400, 300)


def test_png_too(tmp_path: Path) -> None:
    camera = camera_from_exif(photo(tmp_path / "a.png", mm35=28, orientation=1))
    assert camera is not None


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {"orientation": 1},
        {
            "focal": TiffImagePlugin.IFDRational(44, 10)
        },  # real millimetres, on a sensor of unknown size
        {"mm35": 0},
        {"mm35": 65535},
        {"mm35": 2001},
    ],
)
def test_photos_that_do_not_say(tags: dict[str, Any], tmp_path: Path) -> None:
    assert camera_from_exif(photo(tmp_path / "a.jpg", **tags)) is None


@pytest.mark.parametrize("value", ["wide", (28, 35), b"28"])
def test_tags_of_another_type(value: Any, tmp_path: Path) -> None:
    camera = camera_from_exif(photo(tmp_path / "a.jpg", mm35=value))
    assert camera is None or 1.0 <= camera.fx / 500.0 * 43.3 <= 2000.0


def test_files_that_are_no_photos(tmp_path: Path) -> None:
    (tmp_path / "text.jpg").write_text("not a photo")
    (tmp_path / "empty.jpg").write_bytes(b"")
    (tmp_path / "start.jpg").write_bytes(photo(tmp_path / "a.jpg", mm35=28).read_bytes()[:20])
    for name in ("text.jpg", "empty.jpg", "start.jpg", "missing.jpg", "."):
        with pytest.raises(PhotoError, match=r"is not an image that can be decoded|cannot be read"):
            camera_from_exif(tmp_path / name)


@pytest.mark.filterwarnings("ignore:Corrupt EXIF", "ignore:Tag data larger")
def test_damaged_tags(tmp_path: Path) -> None:
    """Any byte of the header spoilt: a camera, none, or the typed error."""
    data = photo(tmp_path / "a.jpg", (40, 30), mm35=28).read_bytes()
    end = data.index(b"\xff\xdb")  # the first table after the tags
    rng = np.random.default_rng(0)
    path = tmp_path / "spoilt.jpg"
    for position in range(2, end):
        spoilt = bytearray(data)
        spoilt[position] = rng.integers(0, 256)
        path.write_bytes(spoilt)
        try:
            camera = camera_from_exif(path)
        except PhotoError:
            continue
        assert camera is None or np.isfinite(camera.fx)
