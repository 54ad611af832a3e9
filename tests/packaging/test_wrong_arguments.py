# SPDX-License-Identifier: Apache-2.0
"""What callers mix up raises a typed error that says what to do instead."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from helpers import random_scene, simple_camera, some_map
from scenes import room_camera, room_map

import gscpe

CAMERA = simple_camera(64, 48)
IMAGE = np.zeros((48, 64, 3), np.uint8)

BAD_IMAGES: list[tuple[str, Any, str]] = [
    ("a path", "photo.jpg", "gscpe.read_image"),
    ("a Path", Path("photo.jpg"), "gscpe.read_image"),
    ("None", None, "not None"),
    ("a list of images", [IMAGE, IMAGE], "one image at a time"),
    ("floats", IMAGE / 255.0, r"np.rint\(255"),
    ("16 bits", IMAGE.astype(np.uint16), ">> 8"),
    ("64 bits", IMAGE.astype(np.int64), "astype"),
    ("booleans", IMAGE > 0, "not bool"),
    ("five channels", np.zeros((48, 64, 5), np.uint8), "shape"),
    ("channels first", np.zeros((3, 48, 64), np.uint8), "transpose"),
    ("a stack", IMAGE[None], "one image at a time"),
    ("a row", IMAGE[0, :, 0], "shape"),
    ("no pixels", np.zeros((0, 0, 3), np.uint8), "no pixels"),
]


@pytest.fixture(scope="module")
def localizer() -> Any:
    with gscpe.Localizer(room_map()) as opened:
        yield opened


@pytest.mark.parametrize(
    ("image", "match"), [case[1:] for case in BAD_IMAGES], ids=[case[0] for case in BAD_IMAGES]
)
def test_images(localizer: gscpe.Localizer, image: Any, match: str) -> None:
    depth = np.ones((48, 64), np.float32)
    several: Any = [image] if isinstance(image, list) else image  # a list of photos is right there
    calls: list[Callable[[], Any]] = [
        lambda: gscpe.to_photo(image, CAMERA),
        lambda: localizer.localize(image, CAMERA),
        lambda: localizer.estimate_camera(several),
        lambda: gscpe.map_from_rgbd(image, depth, CAMERA, np.eye(4)),
    ]
    for call in calls:
        with pytest.raises(gscpe.PhotoError, match=match):
            call()


def test_transparent_pixels_are_for_photos_alone(localizer: gscpe.Localizer) -> None:
    """A photo is masked by them; a map of one RGB-D photo has its depth for that."""
    image = np.dstack([IMAGE, np.full(IMAGE.shape[:2], 255, np.uint8)])
    image[:10, :, 3] = 0
    valid = gscpe.to_photo(image, CAMERA).valid
    assert valid is not None and not valid[:10].any() and valid[10:].all()
    assert not localizer.localize(image, CAMERA).localized
    with pytest.raises(gscpe.CameraError):
        localizer.estimate_camera(image)
    with pytest.raises(gscpe.PhotoError, match=r"image\[:, :, :3\]"):
        gscpe.map_from_rgbd(image, np.ones((48, 64), np.float32), CAMERA, np.eye(4))


def test_grey_images_are_taken() -> None:
    grey = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    for image in (grey, grey[:, :, None]):
        photo = gscpe.to_photo(image, CAMERA)
        np.testing.assert_array_equal(photo.rgb, np.dstack([grey] * 3))


@pytest.mark.parametrize("camera", [np.eye(3), (500.0, 500.0, 320.0, 240.0), None, "PINHOLE"])
def test_cameras(localizer: gscpe.Localizer, camera: Any) -> None:
    with pytest.raises(gscpe.CameraError, match="Camera"):
        localizer.localize(IMAGE, camera)
    with pytest.raises(gscpe.CameraError, match=r"gscpe\.Camera"):
        gscpe.to_photo(IMAGE, camera)
    with pytest.raises(gscpe.CameraError, match=r"gscpe\.Camera"):
        localizer.render(camera, np.eye(4))
    with pytest.raises(gscpe.CameraError, match=r"gscpe\.Camera"):
        gscpe.scene_from_rgbd(IMAGE, np.ones((48, 64), np.float32), camera, np.eye(4))


@pytest.mark.parametrize(
    ("depth", "match"),
    [
        (np.full((48, 64), 2000, np.uint16), "/ 1000"),
        (np.ones((48, 64, 1), np.float32), "shape"),
        ("depth.png", "not str"),
        ([[1.0]], "not list"),
    ],
)
def test_depth_images(depth: Any, match: str) -> None:
    with pytest.raises(gscpe.PhotoError, match=match):
        gscpe.map_from_rgbd(IMAGE, depth, CAMERA, np.eye(4))


def test_paths_of_images() -> None:
    wrong: Any
    for wrong in (None, IMAGE, ["a.jpg"]):
        with pytest.raises(gscpe.PhotoError, match="path of an image"):
            gscpe.read_image(wrong)


def test_a_localizer_opens_a_folder(rng: np.random.Generator, tmp_path: Path) -> None:
    gscpe.save_map(room_map(), tmp_path / "room.gsmap")
    camera = room_camera(64, 48)
    views = []
    for source in (room_map(), tmp_path / "room.gsmap", str(tmp_path / "room.gsmap")):
        with gscpe.Localizer(source) as localizer:
            views.append(localizer.render(camera, np.eye(4)).rgb)
    np.testing.assert_array_equal(views[0], views[1])
    np.testing.assert_array_equal(views[0], views[2])


def test_maps(rng: np.random.Generator, tmp_path: Path) -> None:
    scene = random_scene(rng, 5, 0)
    splat = tmp_path / "splat.ply"
    gscpe.write_splat(scene, splat)
    cases: list[tuple[Any, str]] = [
        (scene, "gscpe.build_map"),
        (None, "this is None"),
        (3, "this is a int"),
        (splat, "it is a file"),
        (str(splat), "it is a file"),
        (tmp_path / "nothing", "build-map"),
        (tmp_path, "build-map"),
    ]
    for wrong, match in cases:
        with pytest.raises(gscpe.MapError, match=match):
            gscpe.Localizer(wrong)
    for wrong, match in cases[1:]:
        with pytest.raises(gscpe.MapError, match=match):
            gscpe.open_map(wrong)
    with pytest.raises(gscpe.MapError, match="a GaussianScene"):
        gscpe.save_map(scene, tmp_path / "map")  # type: ignore[arg-type]
    assert not (tmp_path / "map").exists()
    with pytest.raises(gscpe.SettingsError, match="LocalizerSettings"):
        gscpe.Localizer(some_map(rng), gscpe.CoarseSettings())  # type: ignore[arg-type]


def test_splats(rng: np.random.Generator, tmp_path: Path) -> None:
    map_ = some_map(rng)
    wrong: Any
    for wrong in (map_, "splat.ply", None):
        with pytest.raises(gscpe.SplatError, match=r"gscpe\.read_splat"):
            gscpe.Renderer(wrong)
        with pytest.raises(gscpe.SplatError, match=r"gscpe\.read_splat"):
            gscpe.map_without_references(wrong)
        with pytest.raises(gscpe.SplatError, match=r"gscpe\.read_splat"):
            gscpe.build_map(wrong, map_.references, tmp_path)
    for wrong in ("sparse/0", None):
        with pytest.raises(gscpe.MapError, match="read_colmap_references"):
            gscpe.build_map(map_.scene, wrong, tmp_path)


def test_names_of_references(localizer: gscpe.Localizer) -> None:
    image = np.zeros((180, 240, 3), np.uint8)
    with pytest.raises(gscpe.MapError, match=r"\['a.jpg'\]"):
        localizer.localize(image, room_camera(240, 180), references="a.jpg")
