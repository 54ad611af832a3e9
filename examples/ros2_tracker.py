#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Follows a camera of ROS 2 through a map, and publishes its poses.

Usage: python examples/ros2_tracker.py MAP IMAGE_TOPIC [--ros-args ...]

IMAGE_TOPIC has sensor_msgs/Image, for example /camera/image_raw; the camera's calibration is taken
from camera_info beside it. What comes out on ~/pose, as geometry_msgs/PoseWithCovarianceStamped, is
the pose of the camera's optical frame (x right, y down, z forward) in the frame "map", which is
that of the map's poses; nothing while the camera is lost. The map must be in metres.

There was no ROS where this was written. All of it but main() was tested, with messages made of
plain Python; main(), which needs rclpy, was not run. It was written after rclpy's documentation
(https://docs.ros.org/en/jazzy/p/rclpy/).
"""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any, Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import gscpe


class CameraFollower:
    """What is done with messages. It knows nothing of rclpy.

    Args:
        tracker: of the map.
        topic: of the images.
        publish: is told the time stamp and the result of each frame that has a pose.
        warn: is told what was wrong with a frame, or why there is no pose.
    """

    def __init__(
        self,
        tracker: gscpe.Tracker,
        topic: str,
        publish: Callable[[Any, gscpe.TrackingResult], None],
        warn: Callable[[str], None],
    ) -> None:
        self._tracker, self._topic = tracker, topic
        self._publish, self._warn = publish, warn
        self._camera: gscpe.Camera | None = None

    def on_camera_info(self, message: Any) -> None:
        """The calibration, which usually comes with every image."""
        rectified = "rect" in self._topic.rsplit("/", 1)[-1]  # such images have no distortion left
        try:
            self._camera = gscpe.read_ros_camera(message, self._topic, rectified=rectified)
        except gscpe.GscpeError as error:
            self._warn(str(error))

    def on_image(self, message: Any) -> None:
        """A frame. One that is damaged, or late, is left out."""
        if self._camera is None:
            self._warn(f"no camera_info for {self._topic} yet")
            return
        try:
            image = gscpe.read_ros_image(message, self._topic)
            time = seconds_of(message.header.stamp)
            result = self._tracker.track(image, self._camera, time=time)
        except gscpe.GscpeError as error:
            self._warn(str(error))
            return
        if result.cam_from_world is None:
            self._warn(f"lost: {result.reason}")
        else:
            self._publish(message.header.stamp, result)


def seconds_of(stamp: Any) -> float:
    """Of a builtin_interfaces/Time."""
    return int(stamp.sec) + 1e-9 * int(stamp.nanosec)


def image_info_topic(image_topic: str) -> str:
    """Where the calibration of an image topic is."""
    return image_topic.rsplit("/", 1)[0] + "/camera_info" if "/" in image_topic else "camera_info"


def ros_pose_and_covariance(
    result: gscpe.TrackingResult,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pose of the camera in the world, (4, 4), and its covariance, (6, 6): of the position and of
    rotations about the fixed axes of the world, as geometry_msgs/PoseWithCovariance has it."""
    assert result.cam_from_world is not None and result.covariance is not None
    world_from_cam = np.asarray(np.linalg.inv(result.cam_from_world), dtype=np.float64)
    turned = np.kron(np.eye(2), world_from_cam[:3, :3])
    return world_from_cam, turned @ result.covariance @ turned.T


def fill_pose(message: Any, stamp: Any, result: gscpe.TrackingResult) -> None:
    """Writes a result into a PoseWithCovarianceStamped."""
    world_from_cam, covariance = ros_pose_and_covariance(result)
    message.header.stamp = stamp
    message.header.frame_id = "map"
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y, position.z = world_from_cam[:3, 3].tolist()
    quaternion = Rotation.from_matrix(world_from_cam[:3, :3]).as_quat().tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = quaternion
    message.pose.covariance = covariance.ravel().tolist()


def main() -> None:
    import rclpy
    from geometry_msgs.msg import PoseWithCovarianceStamped
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rclpy.utilities import remove_ros_args
    from sensor_msgs.msg import CameraInfo, Image

    arguments = remove_ros_args(sys.argv)
    if len(arguments) != 3:
        sys.exit(__doc__)
    map_ = gscpe.open_map(arguments[1])
    if map_.metres_per_unit != 1.0:
        sys.exit(f"{arguments[1]} is not in metres, as ROS's poses are")
    topic = arguments[2]
    rclpy.init(args=sys.argv)
    node = rclpy.create_node("gscpe_tracker")
    poses = node.create_publisher(PoseWithCovarianceStamped, "~/pose", 10)
    logger = node.get_logger()

    def publish(stamp: Any, result: gscpe.TrackingResult) -> None:
        message = PoseWithCovarianceStamped()
        fill_pose(message, stamp, result)
        poses.publish(message)

    def warn(text: str) -> None:
        logger.warning(text, throttle_duration_sec=1.0)

    # The newest frame is enough: one that has waited is late.
    newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    with gscpe.Tracker(map_) as tracker:
        follower = CameraFollower(tracker, topic, publish, warn)
        node.create_subscription(
            CameraInfo, image_info_topic(topic), follower.on_camera_info, newest
        )
        node.create_subscription(Image, topic, follower.on_image, newest)
        with suppress(KeyboardInterrupt, ExternalShutdownException):
            rclpy.spin(node)
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
