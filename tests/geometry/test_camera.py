# SPDX-License-Identifier: Apache-2.0
"""Cameras, projection, and the derivatives of projection."""

from __future__ import annotations

from typing import Sequence

import cv2
import numpy as np
import pytest
from helpers import distorted_projection, numeric_jacobian
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gscpe.errors import CameraError
from gscpe.geometry import Camera
from gscpe.geometry.lens import image_of_directions, widest_angle
from gscpe.geometry.projection import (
    pixel_centres,
    pose_jacobian,
    project,
    projection_jacobian,
    transform_points,
    unproject,
)
from gscpe.geometry.se3 import exp

MODELS: dict[str, tuple[float, ...]] = {
    "SIMPLE_PINHOLE": (500.0, 321.0, 239.0),
    "PINHOLE": (500.0, 510.0, 321.0, 239.0),
    "SIMPLE_RADIAL": (500.0, 321.0, 239.0, 0.1),
    "RADIAL": (500.0, 321.0, 239.0, 0.1, -0.05),
    "OPENCV": (500.0, 510.0, 321.0, 239.0, 0.1, -0.05, 0.002, -0.003),
    "FULL_OPENCV": (
        *(500.0, 510.0, 321.0, 239.0),
        *(0.1, -0.05, 0.002, -0.003, 0.01, 0.02, -0.01, 0.005),
    ),
    "SIMPLE_FISHEYE": (500.0, 321.0, 239.0),
    "FISHEYE": (500.0, 510.0, 321.0, 239.0),
    "SIMPLE_RADIAL_FISHEYE": (500.0, 321.0, 239.0, 0.1),
    "RADIAL_FISHEYE": (500.0, 321.0, 239.0, 0.1, -0.05),
    "OPENCV_FISHEYE": (500.0, 510.0, 321.0, 239.0, 0.1, -0.05, 0.02, -0.003),
    "THIN_PRISM_FISHEYE": (
        *(500.0, 510.0, 321.0, 239.0),
        *(0.1, -0.05, 0.002, -0.003, 0.01, 0.02, -0.01, 0.005),
    ),
}
CAMERA = Camera.pinhole(640, 480, fx=520.0, fy=431.0, cx=251.3, cy=290.7)


def random_points(rng: np.random.Generator, count: int = 50) -> NDArray[np.float64]:
    depth = rng.uniform(0.3, 8.0, count)
    return np.stack([*(rng.uniform(-0.8, 0.8, (2, count)) * depth), depth], axis=1)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("separator", [",", " ", ", "])
def test_parse_knows_the_colmap_models(model: str, separator: str) -> None:
    text = separator.join([model, "640", "480", *map(str, MODELS[model])])
    camera = Camera.parse(text)
    assert camera == Camera.from_colmap(model, 640, 480, MODELS[model])
    assert (camera.width, camera.height, camera.cx, camera.cy) == (640, 480, 321.0, 239.0)
    assert camera.fx == 500.0
    assert camera.fy == (500.0 if model.startswith(("SIMPLE", "RADIAL")) else 510.0)
    assert camera.is_pinhole == model.endswith("PINHOLE")
    assert camera.fisheye == model.endswith("FISHEYE")


@pytest.mark.parametrize("model", MODELS)
def test_colmap_sees_the_same_pixels(model: str, rng: np.random.Generator) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="no pycolmap wheel for this machine")
    points = random_points(rng)
    if not hasattr(pycolmap.CameraModelId, model):
        pytest.skip("this pycolmap does not know the model")
    theirs = pycolmap.Camera(model=model, width=640, height=480, params=list(MODELS[model]))
    ours = Camera.from_colmap(model, 640, 480, MODELS[model])
    expected = theirs.img_from_cam(points)
    np.testing.assert_allclose(distorted_projection(ours, points), expected, atol=1e-9)
    pixels, seen = image_of_directions(ours, points)
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
    assert seen.all()


def test_opencv_sees_the_same_pixels(rng: np.random.Generator) -> None:
    """Its fisheye, too, whose top-left pixel has its centre at (0, 0)."""
    points = random_points(rng)
    camera = Camera.from_colmap("OPENCV_FISHEYE", 640, 480, MODELS["OPENCV_FISHEYE"])
    coefficients = np.array(MODELS["OPENCV_FISHEYE"][4:])
    still = np.zeros(3)
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], still, still, camera.opencv_matrix(), coefficients
    )
    pixels, _ = image_of_directions(camera, points)
    np.testing.assert_allclose(pixels - 0.5, expected[:, 0], atol=1e-9)


def test_where_a_lens_images_nothing() -> None:
    """Behind the camera; of a fisheye, beyond where its polynomial turns back."""
    turns_back = Camera.from_colmap("SIMPLE_RADIAL_FISHEYE", 640, 480, (300, 320, 240, -1 / 3))
    assert widest_angle(turns_back) == pytest.approx(1.0, abs=0.005)
    equidistant = Camera.from_colmap("SIMPLE_FISHEYE", 640, 480, (200, 320, 240))
    angles = np.array([0.0, 0.5, 0.99, 1.02, 2.0])
    directions = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    pixels, seen = image_of_directions(turns_back, directions)
    assert seen.tolist() == [True, True, True, False, False]
    pixels, seen = image_of_directions(equidistant, directions)
    assert seen.all()
    np.testing.assert_allclose(pixels[:, 0], 320 + 200 * angles)
    assert image_of_directions(CAMERA, directions)[1].tolist() == [True] * 4 + [False]


@pytest.mark.parametrize(("focal", "pinhole"), [(500.0, 500.0), (200.0, 320 / 1.2)])
def test_the_pinhole_in_place_of_a_fisheye(focal: float, pinhole: float) -> None:
    """The resolution of the middle; at most 50 degrees to a side."""
    camera = Camera.from_colmap("OPENCV_FISHEYE", 640, 480, (focal, focal, 320, 240, 0.1, 0, 0, 0))
    assert camera.without_distortion() == Camera.pinhole(
        640, 480, fx=pinhole, fy=pinhole, cx=320, cy=240
    )


def test_zero_distortion_is_a_pinhole() -> None:
    assert Camera.from_colmap("RADIAL", 64, 48, (50.0, 32.0, 24.0, 0.0, 0.0)).is_pinhole


@pytest.mark.parametrize("model", MODELS)
def test_colmap_text_is_read_back_exactly(model: str) -> None:
    camera = Camera.from_colmap(model, 640, 480, [p * (1 + 1e-15) / 3 for p in MODELS[model]])
    assert Camera.parse(camera.colmap_text()) == camera


def test_colmap_text_of_numpy_numbers() -> None:
    numbers = np.array([500.1, 510.2, 320.3, 240.4])
    camera = Camera(640, 480, *numbers)
    assert Camera.parse(camera.colmap_text()) == camera
    resized = CAMERA.resized(*np.array([320, 240]))
    assert Camera.parse(resized.colmap_text()) == resized


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not of the form MODEL,width,height"),
        ("PINHOLE", "not of the form"),
        ("PINHOLE,640,480,a,b,c,d", "not of the form"),
        ("PINHOLE,640.5,480,500,500,320,240", "not of the form"),
        ("FOV,640,480,500,500,320,240,1", "'FOV' is not supported.*undistort the photos"),
        ("OPENCV_FISHEYE,640,480,500,500,320,240", "takes 8 parameters"),
        ("PINHOLE,640,480,500,320,240", r"takes 4 parameters \(fx, fy, cx, cy\), got 3"),
        ("PINHOLE,640,480,500,500,320,240,0", "takes 4 parameters .*, got 5"),
        ("PINHOLE,0,480,500,500,320,240", "size must be positive, not 0x480"),
        ("PINHOLE,640,-1,500,500,320,240", "size must be positive"),
        ("PINHOLE,640,480,0,500,320,240", "focal lengths must be positive"),
        ("PINHOLE,640,480,500,-5,320,240", "focal lengths must be positive"),
        ("PINHOLE,640,480,nan,500,320,240", "finite"),
        ("PINHOLE,640,480,500,500,inf,240", "finite"),
        ("SIMPLE_RADIAL,640,480,500,320,240,nan", "finite"),
    ],
)
def test_parse_names_what_is_wrong(text: str, message: str) -> None:
    with pytest.raises(CameraError, match=message):
        Camera.parse(text)


def test_distortion_has_eight_numbers_or_none() -> None:
    with pytest.raises(CameraError, match="distortion must be empty or"):
        Camera(640, 480, 500.0, 500.0, 320.0, 240.0, (0.1, 0.2))


@given(st.integers(1, 2000), st.integers(1, 2000))
def test_resizing_scales_every_pixel_coordinate(width: int, height: int) -> None:
    points = random_points(np.random.default_rng(7))
    resized = CAMERA.resized(width, height)
    assert (resized.width, resized.height) == (width, height)
    scale = np.array([width / 640, height / 480])
    np.testing.assert_allclose(
        project(resized, points), project(CAMERA, points) * scale, rtol=1e-12
    )


def test_resizing_keeps_distortion() -> None:
    camera = Camera.from_colmap("OPENCV", 640, 480, MODELS["OPENCV"])
    half = camera.resized(320, 240)
    assert half.distortion == camera.distortion
    points = random_points(np.random.default_rng(7))
    np.testing.assert_allclose(
        distorted_projection(half, points), distorted_projection(camera, points) / 2, rtol=1e-12
    )


def test_removing_distortion_keeps_the_rest() -> None:
    camera = Camera.from_colmap("OPENCV", 640, 480, MODELS["OPENCV"])
    assert camera.without_distortion() == Camera.pinhole(
        640, 480, fx=500.0, fy=510.0, cx=321.0, cy=239.0
    )


def test_the_matrices() -> None:
    np.testing.assert_array_equal(
        CAMERA.matrix(), [[520.0, 0.0, 251.3], [0.0, 431.0, 290.7], [0.0, 0.0, 1.0]]
    )
    half_a_pixel = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(CAMERA.opencv_matrix(), CAMERA.matrix() - half_a_pixel, atol=1e-12)


@pytest.mark.parametrize("shape", [(480, 640), (480, 640, 3)])
def test_check_fits_accepts_its_size(shape: Sequence[int]) -> None:
    CAMERA.check_fits(tuple(shape), "the photo")


@pytest.mark.parametrize("shape", [(640, 480, 3), (240, 320, 3), (480, 639)])
def test_check_fits_names_both_sizes(shape: tuple[int, ...]) -> None:
    with pytest.raises(CameraError) as caught:
        CAMERA.check_fits(shape, "photo a.jpg")
    for words in ("photo a.jpg", f"{shape[1]}x{shape[0]}", "640x480"):
        assert words in str(caught.value)


def test_pixel_centres_start_at_one_half() -> None:
    centres = pixel_centres(Camera.pinhole(3, 2, fx=1, fy=1, cx=1, cy=1))
    assert centres.shape == (2, 3, 2)
    np.testing.assert_array_equal(centres[0, 0], [0.5, 0.5])
    np.testing.assert_array_equal(centres[1, 2], [2.5, 1.5])


def test_unproject_undoes_project(rng: np.random.Generator) -> None:
    points = random_points(rng)
    again = unproject(CAMERA, project(CAMERA, points), points[:, 2])
    np.testing.assert_allclose(again, points, atol=1e-12)
    pixels = rng.uniform(-50, 700, (40, 2))
    depth = rng.uniform(0.1, 20.0, 40)
    np.testing.assert_allclose(project(CAMERA, unproject(CAMERA, pixels, depth)), pixels, atol=1e-9)


def test_projection_is_the_intrinsic_matrix(rng: np.random.Generator) -> None:
    points = random_points(rng)
    homogeneous = points @ CAMERA.matrix().T
    np.testing.assert_allclose(
        project(CAMERA, points), homogeneous[:, :2] / homogeneous[:, 2:], rtol=1e-12
    )


def test_projection_jacobian(rng: np.random.Generator) -> None:
    points = random_points(rng)
    for point, jacobian in zip(points, projection_jacobian(CAMERA, points), strict=True):
        numeric = numeric_jacobian(lambda p: project(CAMERA, p[None])[0], point)
        np.testing.assert_allclose(jacobian, numeric, rtol=1e-5, atol=1e-4)


def test_pose_jacobian(rng: np.random.Generator) -> None:
    points = random_points(rng)

    def all_moved(xi: NDArray[np.float64]) -> NDArray[np.float64]:
        return project(CAMERA, transform_points(exp(xi), points))

    numeric = numeric_jacobian(all_moved, np.zeros(6))
    np.testing.assert_allclose(pose_jacobian(CAMERA, points), numeric, rtol=1e-5, atol=1e-4)


def test_what_is_typed_is_looked_at() -> None:
    """Slips with which photos would be found nowhere, after a long time."""
    good = "PINHOLE,640,480,525,525,320,240"
    assert Camera.typed(good) == Camera.parse(good)
    assert Camera.typed("PINHOLE,640,480,20,20,-300,900")  # wide, and a detail of a photo
    for wrong, why in (
        ("PINHOLE,640,480,0.82,525,320,240", "fx = 0.82 is far too short"),
        ("PINHOLE,640,480,525,1e9,320,240", "fy = 1e\\+09 is far too long"),
        ("PINHOLE,640,480,525,525,1e18,240", "cx = 1e\\+18 is far outside"),
        ("PINHOLE,640", "of the form"),
    ):
        with pytest.raises(CameraError, match=why):
            Camera.typed(wrong)


@pytest.mark.parametrize("size", [640.0, 640.5, "640", None])
def test_sizes_are_whole_numbers(size: object) -> None:
    with pytest.raises(CameraError, match="whole numbers of pixels"):
        Camera(size, 480, 500.0, 500.0, 320.0, 240.0)  # type: ignore[arg-type]
    assert Camera(np.int64(640), 480, 500.0, 500.0, 320.0, 240.0).width == 640  # type: ignore[arg-type]
