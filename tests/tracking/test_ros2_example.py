# SPDX-License-Identifier: Apache-2.0
"""The example of a ROS 2 node, with messages like those of rclpy; there is no rclpy here."""

from __future__ import annotations

import sys
from array import array
from importlib import util
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from moving_camera import CAMERA, picture, pose, right
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gscpe import Tracker, TrackingResult, read_ros_camera, read_ros_image
from gscpe.errors import PhotoError, SequenceError

PATH = Path(__file__).resolve().parents[2] / "examples" / "ros2_tracker.py"
TOPIC = "/camera/image_raw"


@pytest.fixture(scope="module")
def example() -> Any:
    spec = util.spec_from_file_location("ros2_tracker", PATH)
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert "rclpy" not in sys.modules
    return module


def image_message(rgb: NDArray[np.uint8], index: int) -> SimpleNamespace:
    """As rclpy gives it: numbers in an array.array, and no name of its type."""
    height, width = rgb.shape[:2]
    stamp = SimpleNamespace(sec=1_700_000_000 + index // 30, nanosec=index % 30 * 33_333_333)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id="camera"),
        height=height,
        width=width,
        encoding="bgr8",
        step=3 * width,
        data=array("B", np.ascontiguousarray(rgb[:, :, ::-1]).tobytes()),
    )


def info_message(k: list[float]) -> SimpleNamespace:
    region = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    return SimpleNamespace(
        width=CAMERA.width,
        height=CAMERA.height,
        distortion_model="plumb_bob",
        d=array("d", [0.0] * 5),
        k=np.array(k),
        p=np.array([*k[:3], 0, *k[3:6], 0, *k[6:], 0]),
        binning_x=0,
        binning_y=0,
        roi=region,
    )


def calibration() -> list[float]:
    """OpenCV counts from the centre of the first pixel."""
    return [CAMERA.fx, 0, CAMERA.cx - 0.5, 0, CAMERA.fy, CAMERA.cy - 0.5, 0, 0, 1]


def new_pose() -> SimpleNamespace:
    where = SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace())
    return SimpleNamespace(header=SimpleNamespace(), pose=SimpleNamespace(pose=where))


def test_messages_of_rclpy_are_read() -> None:
    np.testing.assert_array_equal(read_ros_image(image_message(picture(0), 0), TOPIC), picture(0))
    camera = read_ros_camera(info_message(calibration()), TOPIC)
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (
        *(CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy),
    )
    cut_off = image_message(picture(0), 0)
    cut_off.data = cut_off.data[:-1]
    with pytest.raises(PhotoError, match="it is damaged"):
        read_ros_image(cut_off, TOPIC)
    cut_off.encoding = "16UC1"
    with pytest.raises(SequenceError, match="images of /camera/image_raw are encoded as '16UC1'"):
        read_ros_image(cut_off, TOPIC)


def test_a_camera_is_followed(example: Any, tracker: Tracker) -> None:
    """What is damaged, late, or without a calibration is told, and does no harm."""
    published: list[tuple[Any, TrackingResult]] = []
    warned: list[str] = []
    follower = example.CameraFollower(
        tracker, TOPIC, lambda stamp, result: published.append((stamp, result)), warned.append
    )
    follower.on_image(image_message(picture(0), 0))
    assert warned == [f"no camera_info for {TOPIC} yet"]
    follower.on_camera_info(info_message([0.0] * 9))
    assert "calibrat" in warned[1]
    follower.on_camera_info(info_message(calibration()))
    for index in range(3):
        follower.on_image(image_message(picture(index), index))
    follower.on_image(image_message(picture(2), 2))
    damaged = image_message(picture(3), 3)
    damaged.step = 1
    follower.on_image(damaged)
    follower.on_image(image_message(picture(4), 4))
    assert len(warned) == 4, warned
    assert "later" in warned[2] and "damaged" in warned[3]
    assert [stamp.nanosec for stamp, _ in published] == [33_333_333 * i for i in (0, 1, 2, 4)]
    for (_, result), index in zip(published, (0, 1, 2, 4), strict=True):
        right(result, pose(index))


def test_what_is_published(example: Any) -> None:
    """Position, orientation and covariance are those of the camera in the world."""
    root = np.random.default_rng(1).normal(size=(6, 6))
    result = TrackingResult("tracking", None, pose(3), root @ root.T, 0, 1.0, 1.0)
    message, stamp = new_pose(), SimpleNamespace(sec=1, nanosec=5)
    example.fill_pose(message, stamp, result)
    assert (message.header.frame_id, message.header.stamp) == ("map", stamp)
    where = message.pose.pose
    world_from_cam = np.eye(4)
    orientation = [getattr(where.orientation, name) for name in "xyzw"]
    world_from_cam[:3, :3] = Rotation.from_quat(orientation).as_matrix()
    world_from_cam[:3, 3] = [getattr(where.position, name) for name in "xyz"]
    np.testing.assert_allclose(world_from_cam @ pose(3), np.eye(4), atol=1e-12)
    assert len(message.pose.covariance) == 36
    assert {type(number) for number in (*orientation, *message.pose.covariance)} == {float}
    turned = np.array(message.pose.covariance).reshape(6, 6)
    expected = world_from_cam[:3, :3] @ (root @ root.T)[:3, :3] @ world_from_cam[:3, :3].T
    np.testing.assert_allclose(turned[:3, :3], expected)


@pytest.mark.parametrize(
    ("images", "info"),
    [("/a/image_raw", "/a/camera_info"), ("/image", "/camera_info"), ("image", "camera_info")],
)
def test_the_calibration_is_beside_the_images(example: Any, images: str, info: str) -> None:
    assert example.image_info_topic(images) == info
