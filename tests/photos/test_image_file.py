# SPDX-License-Identifier: Apache-2.0
"""Photos of more bits, of floats, with transparency, and HEIC: read right, or told why not."""

from __future__ import annotations

import builtins
import io
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import simple_camera
from numpy.typing import NDArray
from PIL import Image

from gscpe import camera_from_exif, read_image
from gscpe.errors import CameraError, PhotoError
from gscpe.geometry import Camera
from gscpe.photos import read_image_of, to_photo

SIZE = (47, 61)


@pytest.fixture
def picture(rng: np.random.Generator) -> NDArray[np.uint8]:
    return rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8)


def save(path: Path, values: NDArray[Any]) -> Path:
    """RGB or RGBA of any type, as the ending says."""
    order = [2, 1, 0, *range(3, values.shape[2])]
    assert cv2.imwrite(str(path), np.ascontiguousarray(values[:, :, order]))
    return path


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_raw_bits_in_sixteen_are_stretched(
    suffix: str, bits: int, tmp_path: Path, picture: NDArray[np.uint8]
) -> None:
    """A camera of 12 bits stores up to 4095; the photo would be black, taken as 16 bits."""
    path = save(tmp_path / f"a{suffix}", picture.astype(np.uint16) << (bits - 8))
    np.testing.assert_array_equal(read_image(path), picture)


@pytest.mark.parametrize(("dtype", "factor"), [("f4", 1 / 255), ("f8", 1 / 255), ("f4", 1.0)])
def test_float_images(
    dtype: str, factor: float, tmp_path: Path, picture: NDArray[np.uint8]
) -> None:
    path = save(tmp_path / "a.tif", (picture * factor).astype(dtype))
    np.testing.assert_array_equal(read_image(path), picture)


def test_what_is_not_a_number_is_not_seen(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    values = picture.astype(np.float32) / 255
    values[5, 7, 1] = np.nan
    image = read_image(save(tmp_path / "a.tif", values))
    assert image.shape == (*SIZE, 4)
    assert np.argwhere(image[:, :, 3] != 255).tolist() == [[5, 7]]


@pytest.mark.parametrize("dtype", [np.int32, np.float32])
def test_values_of_no_known_range(dtype: Any, tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    path = save(tmp_path / "a.tif", (picture.astype(np.float64) * 1e6).astype(dtype))
    with pytest.raises(PhotoError, match=r"a\.tif holds (int|float)32 values up to .* 8-bit PNG"):
        read_image(path)


def with_hole(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    alpha = np.full((*SIZE, 1), 255, np.uint8)
    alpha[:, :20] = 0
    alpha[:5, 30:] = 100  # more than half transparent
    return np.concatenate([picture, alpha], axis=2)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".webp"])
def test_transparent_pixels_are_masked(
    suffix: str, tmp_path: Path, picture: NDArray[np.uint8]
) -> None:
    image = read_image(save(tmp_path / f"a{suffix}", with_hole(picture)))
    assert image.shape == (*SIZE, 4)
    photo = to_photo(image, simple_camera(61, 47))
    assert photo.valid is not None
    np.testing.assert_array_equal(photo.valid, with_hole(picture)[:, :, 3] == 255)
    assert photo.rgb.shape == (*SIZE, 3)


def test_other_kinds_of_transparency(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    """Grey with alpha, a transparent colour of a palette, and 16 bits."""
    alpha = Image.fromarray(with_hole(picture)[:, :, 3])
    Image.merge("LA", [Image.fromarray(picture[:, :, 0]), alpha]).save(tmp_path / "a.png")
    indices = np.zeros(SIZE, np.uint8)
    indices[:, 20:] = 1
    palette = Image.fromarray(indices, "P")
    palette.putpalette([10, 20, 30, 40, 50, 60])
    palette.save(tmp_path / "b.png", transparency=0)
    save(tmp_path / "c.png", with_hole(picture).astype(np.uint16) * 257)
    for name in "abc":
        image = read_image(tmp_path / f"{name}.png")
        assert image.shape == (*SIZE, 4)
        assert not image[:, :20, 3].any()
        assert (image[10:, 20:, 3] == 255).all()


def test_opaque_and_wholly_transparent(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    rgba = np.dstack([picture, np.full(SIZE, 255, np.uint8)])
    np.testing.assert_array_equal(read_image(save(tmp_path / "a.png", rgba)), picture)
    rgba[:, :, 3] = 3
    with pytest.raises(PhotoError, match=r"b\.png is completely transparent"):
        read_image(save(tmp_path / "b.png", rgba))


def test_masks_are_undistorted_with_the_photo(picture: NDArray[np.uint8]) -> None:
    camera = Camera(61, 47, 50.0, 50.0, 30.5, 23.5, (-0.3, 0.1, 0, 0, 0, 0, 0, 0))
    plain = to_photo(picture, camera).valid
    masked = to_photo(with_hole(picture), camera).valid
    assert masked is not None
    assert not masked[:, :19].any()
    inside = masked[10:-3, 22:-3]
    assert inside.all()
    assert plain is None or not np.any(masked & ~plain)


def heic(path: Path, picture: NDArray[np.uint8], **tags: Any) -> Path:
    pillow_heif = pytest.importorskip("pillow_heif", reason="pillow-heif is an optional package")
    exif = Image.Exif()
    for tag, value in tags.items():
        exif.get_ifd(0x8769)[{"mm35": 0xA405}[tag]] = value
    file = pillow_heif.from_pillow(Image.fromarray(picture))
    buffer = io.BytesIO()
    file.save(buffer, quality=100, chroma=444, exif=exif.tobytes())
    path.write_bytes(buffer.getvalue())
    return path


@pytest.mark.parametrize("name", ["a.heic", "a.jpg"])
def test_heic_by_its_first_bytes(name: str, tmp_path: Path, rng: np.random.Generator) -> None:
    smooth = cv2.resize(rng.integers(0, 256, (4, 5, 3), dtype=np.uint8), (64, 48))
    path = heic(tmp_path / name, np.asarray(smooth, dtype=np.uint8), mm35=26)
    image = read_image(path)
    assert image.shape == (48, 64, 3)
    assert np.abs(image.astype(float) - smooth).mean() < 3.0
    camera = camera_from_exif(path, upright=True)
    assert camera is not None
    assert (camera.width, camera.height) == (64, 48)
    assert camera.fx == pytest.approx(26 * 80 / 43.2666, rel=1e-4)


def test_damaged_heic(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    data = heic(tmp_path / "a.heic", picture).read_bytes()
    for length in (24, 60, len(data) // 2, len(data) - 20):
        (tmp_path / "b.heic").write_bytes(data[:length])
        try:
            assert read_image(tmp_path / "b.heic").shape == picture.shape
        except PhotoError as error:
            assert "b.heic" in str(error)


def test_heic_without_pillow_heif(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.heic"
    path.write_bytes(b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic" + bytes(20))
    real = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name == "pillow_heif":
            raise ImportError(name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    for read in (read_image, camera_from_exif):
        with pytest.raises(PhotoError, match=r"a\.heic is HEIC.*pip install 'gscpe\[heic\]'"):
            read(path)


def test_avif_is_not_taken_for_heic(tmp_path: Path) -> None:
    picture = np.full((32, 32, 3), 120, np.uint8)
    try:
        Image.fromarray(picture).save(tmp_path / "a.avif")
    except (OSError, KeyError, ValueError):
        pytest.skip("this Pillow does not write AVIF")
    np.testing.assert_allclose(read_image(tmp_path / "a.avif"), 120, atol=3)


def test_a_camera_of_the_turned_photo_without_exif(
    tmp_path: Path, picture: NDArray[np.uint8]
) -> None:
    path = save(tmp_path / "a.png", picture)
    with pytest.raises(CameraError, match=r"a\.png is 61x47, but its camera is 47x61, which"):
        read_image_of(path, simple_camera(47, 61))
    with pytest.raises(CameraError, match=r"a\.png is 61x47, but its camera is 640x480"):
        read_image_of(path, simple_camera(640, 480))


def test_what_is_wrong_with_a_file_is_said(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    whole = cv2.imencode(".jpg", picture)[1].tobytes()
    for data, words in (
        (b"", "is empty"),
        (whole[:200], "is a JPEG that is cut off"),
        (b"no picture", "is not an image that can be decoded"),
    ):
        path = tmp_path / "photo.jpg"
        path.write_bytes(data)
        with pytest.raises(PhotoError, match=rf"photo\.jpg {words}"):
            read_image(path)
