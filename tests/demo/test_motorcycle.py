# SPDX-License-Identifier: Apache-2.0
"""The Middlebury Motorcycle pair: real photos whose true pose is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gscpe.demo import DemoReport, Motorcycle, load_motorcycle, run_demo
from gscpe.demo.pictures import ARROW, ARROW_SCALE, shifts
from gscpe.geometry import pose_difference, se3
from gscpe.geometry.projection import pixel_centres, project, transform_points, unproject
from gscpe.mapping import map_from_rgbd
from gscpe.photos import read_image
from gscpe.render import Renderer


@pytest.fixture(scope="module")
def pair() -> Motorcycle:
    return load_motorcycle()


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> DemoReport:
    return run_demo(tmp_path_factory.mktemp("demo"))


def test_conventions(pair: Motorcycle) -> None:
    """A point of the left photo lies its disparity further left in the right one."""
    disparity = raw_disparity()
    row, column = np.nonzero(pair.left_depth > 0)
    pixels = np.stack([column, row], axis=1).astype(np.float64) + 0.5
    points = unproject(pair.left_camera, pixels, pair.left_depth[row, column].astype(np.float64))
    seen = project(pair.right_camera, transform_points(pair.right_from_left, points))
    np.testing.assert_allclose(seen[:, 0], pixels[:, 0] - disparity[row, column], atol=1e-3)
    np.testing.assert_allclose(seen[:, 1], pixels[:, 1], atol=1e-9)


def raw_disparity() -> NDArray[np.float64]:
    import skimage.data

    return np.asarray(skimage.data.stereo_motorcycle()[2], dtype=np.float64)


def test_the_photos_agree_with_the_depth(pair: Motorcycle) -> None:
    """The right photo, carried to the left by the depth, shows the same, and fits best without
    a shift between the two."""
    known = pair.left_depth > 0
    pixels = pixel_centres(pair.left_camera).reshape(-1, 2)
    depth = np.where(known, pair.left_depth, 1.0).astype(np.float64).ravel()
    points = unproject(pair.left_camera, pixels, depth)
    seen = project(pair.right_camera, transform_points(pair.right_from_left, points)) - 0.5
    u, v = seen.T.reshape(2, *known.shape).astype(np.float32)

    def difference(shift: float) -> float:
        warped = cv2.remap(pair.right, u + np.float32(shift), v, cv2.INTER_CUBIC)
        return float(np.mean(np.abs(warped.astype(float) - pair.left)[known]))

    assert difference(0.0) < 12.0
    assert difference(0.0) < 0.95 * min(difference(0.5), difference(-0.5))


def test_types_and_sizes(pair: Motorcycle) -> None:
    assert pair.left.shape == pair.right.shape == (500, 741, 3)
    assert pair.left.dtype == pair.right.dtype == np.uint8
    assert pair.left_depth.dtype == np.float32
    known = pair.left_depth > 0
    assert 0.7 < known.mean() < 1.0
    assert np.isfinite(pair.left_depth).all()
    assert 1.5 < pair.left_depth[known].min() < pair.left_depth[known].max() < 6.0
    # Middlebury's principal points, whose first pixel centre is (0, 0), in COLMAP's convention.
    assert (pair.left_camera.cx, pair.left_camera.cy) == pytest.approx((311.693, 255.377))
    assert (pair.right_camera.cx, pair.right_camera.cy) == pytest.approx((342.779, 255.377))
    baseline = pose_difference(pair.right_from_left, np.eye(4))
    assert baseline.distance == pytest.approx(0.193001)
    assert baseline.degrees == 0.0


def test_the_demo_finds_the_true_pose(report: DemoReport) -> None:
    """Measured: 0.5 mm and 0.007 degrees; SIFT and PnP alone 0.9 mm and 0.013 degrees."""
    assert report.final_error.distance <= 0.8e-3
    assert report.final_error.degrees <= 0.012
    assert report.final_error.distance < report.coarse_error.distance
    assert report.final_error.degrees < report.coarse_error.degrees
    result = report.result
    assert result.localized
    assert result.cam_from_world is not None
    error = pose_difference(result.cam_from_world, report.true_cam_from_world)
    assert error == report.final_error
    assert result.reference == "motorcycle-left"
    assert report.gaussians > 200_000


def test_the_demo_draws_pictures(report: DemoReport) -> None:
    assert len(report.pictures) == 10
    for name, path in report.pictures.items():
        assert path.is_absolute()
        picture = read_image(path)
        if name != "overview":
            assert picture.shape == (500, 741, 3)
        assert picture.std() > 5.0
    np.testing.assert_array_equal(read_image(report.pictures["photo"]), load_motorcycle().right)
    differences = [path for name, path in report.pictures.items() if "difference" in name]
    assert len(differences) == 3
    assert {"build map", "retrieval", "coarse", "refinement", "total"} <= set(report.seconds)


def test_the_overview_shows_what_refinement_did(pair: Motorcycle, report: DemoReport) -> None:
    """The arrows are the shifts of the map's points between the true pose and another: a turn
    about y moves the middle of the picture by f tan(angle), the true pose moves nothing."""
    turned = se3.exp([0, 0, 0, 0, np.radians(0.1), 0]) @ pair.right_from_left
    map_ = map_from_rgbd(pair.left, pair.left_depth, pair.left_camera, np.eye(4))
    with Renderer(map_.scene) as renderer:
        view = renderer.render(pair.right_camera, pair.right_from_left)
    pixels, moved, known = shifts(view, turned)
    middle = known & (np.linalg.norm(pixels - (342.779, 255.377), axis=2) < 40)
    assert np.count_nonzero(middle) > 1000
    expected = (994.978 * np.tan(np.radians(0.1)), 0.0)
    np.testing.assert_allclose(moved[middle] - expected, 0.0, atol=0.02)
    assert np.abs(shifts(view, pair.right_from_left)[1][known]).max() < 1e-9
    coarse, final = (
        report.pictures[f"shift at the {stage} pose (x{ARROW_SCALE})"]
        for stage in ("coarse", "final")
    )
    drawn = [np.mean(np.all(read_image(path) == ARROW, axis=2)) for path in (coarse, final)]
    assert drawn[1] < 0.8 * drawn[0]  # shorter arrows
    overview = read_image(report.pictures["overview"]).astype(float)
    height = overview.shape[0] // 3
    for row in (height, 2 * height):  # the pairs that show a gain do not look the same
        left, right = np.split(overview[row + 26 : row + height - 60], 2, axis=1)
        assert np.mean(np.abs(left - right)) > 5.0


def test_the_map_is_not_shifted_from_its_photo(pair: Motorcycle) -> None:
    """Flow between the photo and the render at its pose, where there is texture (measured:
    0.01 px). One fat disc a pixel would be off by up to 0.7 px."""
    map_ = map_from_rgbd(pair.left, pair.left_depth, pair.left_camera, np.eye(4))
    with Renderer(map_.scene) as renderer:
        view = renderer.render(pair.left_camera, np.eye(4))
    seen = view.opacity > 0.9
    rendered = np.rint(255 * np.clip(view.rgb, 0, 1)).astype(np.uint8)
    rendered[~seen] = pair.left[~seen]
    photo, render = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (pair.left, rendered))
    unknown = np.zeros((*photo.shape, 2), np.float32)
    medium = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = medium.calc(photo, render, unknown)
    blurred = cv2.GaussianBlur(photo.astype(np.float32), (0, 0), 1.5)
    texture = np.hypot(cv2.Sobel(blurred, -1, 1, 0), cv2.Sobel(blurred, -1, 0, 1))
    inner = cv2.erode(seen.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    length = np.linalg.norm(flow, axis=2)[inner & (texture > np.median(texture))]
    assert len(length) > 50_000
    assert np.median(length) < 0.05
    assert np.quantile(length, 0.9) < 0.15
