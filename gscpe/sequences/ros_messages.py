# SPDX-License-Identifier: Apache-2.0
"""ROS's messages of cameras: images, compressed images and calibrations, of ROS 1 and 2, as bags
hold them and as running programs receive them.

https://docs.ros.org/en/noetic/api/sensor_msgs/html/index-msg.html,
https://github.com/ros2/common_interfaces/blob/rolling/sensor_msgs/include/sensor_msgs/image_encodings.hpp
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.errors import PhotoError, SequenceError
from gscpe.geometry.camera import Camera
from gscpe.sequences.camera import camera_of_calibration

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

# Encoding -> channels, and what makes RGB of it; None where it is RGB already. OpenCV's names of
# Bayer patterns (of four letters) are those of the first two rows, as ROS's are.
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "8uc3": (3, cv2.COLOR_BGR2RGB),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "8uc4": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8uc1": (1, cv2.COLOR_GRAY2RGB),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
}


def read_ros_image(message: Any, topic: str) -> UInt8Array:
    """The picture in a message of ROS 1 or 2; its header tells when it was taken.

    Args:
        message: ``sensor_msgs/Image`` or ``CompressedImage``, of rclpy or rosbags.
        topic: that it came from, for errors.

    Returns:
        (H, W, 3) uint8 RGB; grey has three equal channels.

    Raises:
        SequenceError: images of this encoding cannot be used.
        PhotoError: it is damaged, or empty.
    """
    check_encoding(message, topic)
    return image_of(message)


def check_encoding(message: Any, topic: str) -> None:
    """Raises SequenceError where images of this kind cannot be used, with what can."""
    if _is_compressed(message):
        if "compresseddepth" in str(message.format).lower():
            raise SequenceError(f"{topic} holds depth ({message.format}); give a topic of pictures")
    elif message.encoding.lower() not in _ENCODINGS:
        raise SequenceError(
            f"images of {topic} are encoded as {message.encoding!r}, which is not known (known: "
            f"{', '.join(sorted(_ENCODINGS))}); give another topic"
        )


def image_of(message: Any) -> UInt8Array:
    """(H, W, 3) RGB of an Image or CompressedImage; grey has three equal channels.

    Raises:
        PhotoError: it is damaged, or empty.
    """
    if _is_compressed(message):
        return _decompressed(message)
    channels, conversion = _ENCODINGS[message.encoding.lower()]
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if min(height, width) < 1 or step < width * channels or data.size < height * step:
        raise PhotoError(
            f"an image of {width}x{height} {message.encoding} with rows of {step} bytes cannot "
            f"have {data.size} bytes: it is damaged"
        )
    rows = data[: height * step].reshape(height, step)[:, : width * channels]
    pixels = rows.reshape(height, width, channels) if channels > 1 else rows
    pixels = np.ascontiguousarray(pixels)
    try:
        rgb = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    except cv2.error as error:  # an odd width where two pixels share a colour
        raise PhotoError(
            f"{width}x{height} is no possible size of an image in {message.encoding}"
        ) from error
    return np.asarray(rgb, dtype=np.uint8)


def _is_compressed(message: Any) -> bool:
    """Only the raw ones have an encoding; rclpy's do not tell the name of their type."""
    return not hasattr(message, "encoding")


def _decompressed(message: Any) -> UInt8Array:
    data = np.asarray(message.data, dtype=np.uint8)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        bgr = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        bgr = None
    if bgr is None:
        raise PhotoError(f"a compressed image ({message.format}) cannot be decoded: it is damaged")
    return np.ascontiguousarray(bgr[:, :, ::-1], dtype=np.uint8)


def nanoseconds_of(message: Any, recorded: int) -> int:
    """Nanoseconds: when the picture was taken, or, where the driver does not say, recorded."""
    stamp = message.header.stamp
    taken = int(stamp.sec) * 10**9 + int(stamp.nanosec)
    return taken if taken > 0 else recorded


def read_ros_camera(message: Any, topic: str, *, rectified: bool = False) -> Camera:
    """The camera of a ``sensor_msgs/CameraInfo`` of ROS 1 or 2. OpenCV's pixels become ours;
    binning and a region of interest count.

    Args:
        message: of rclpy or rosbags.
        topic: of the message, for errors.
        rectified: whether the pictures are free of distortion (``image_rect``): their matrix is P.

    Raises:
        CameraError: it is not calibrated, or of an unknown model.
    """
    old = hasattr(message, "K")  # ROS 1 has capital letters
    matrix, distortion = (message.K, message.D) if old else (message.k, message.d)
    model = str(message.distortion_model)
    if rectified:
        p = message.P if old else message.p
        matrix, model, distortion = [*p[0:3], *p[4:7], *p[8:11]], "", ()
    across, down = max(1, int(message.binning_x)), max(1, int(message.binning_y))
    roi = message.roi
    size = (int(roi.width) or int(message.width), int(roi.height) or int(message.height))
    full = camera_of_calibration(size, matrix, model, distortion, topic)
    return replace(
        full,
        width=size[0] // across,
        height=size[1] // down,
        fx=full.fx / across,
        fy=full.fy / down,
        cx=(full.cx - int(roi.x_offset)) / across,
        cy=(full.cy - int(roi.y_offset)) / down,
    )
