# SPDX-License-Identifier: Apache-2.0
"""ROS bags as robots record them, written through rosbags."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Sequence

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

Kind = Literal["bag", "db3", "mcap"]
KINDS: tuple[Kind, ...] = ("bag", "db3", "mcap")

INFO = "sensor_msgs/msg/CameraInfo"
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


class Messages:
    """Makes messages of ROS 1 or 2."""

    def __init__(self, kind: Kind) -> None:
        pytest.importorskip("rosbags")
        from rosbags.typesys import Stores, get_typestore

        self.ros1 = kind == "bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)

    def _header(self, nanoseconds: int) -> Any:
        types = self.store.types
        stamp = types["builtin_interfaces/msg/Time"](
            sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
        )
        header = types["std_msgs/msg/Header"]
        if self.ros1:
            return header(seq=0, stamp=stamp, frame_id="camera")
        return header(stamp=stamp, frame_id="camera")

    def image(
        self, nanoseconds: int, pixels: NDArray[np.uint8], encoding: str, padding: int = 0
    ) -> Any:
        """Pixels, (H, W) or (H, W, C), as they are; with bytes after each row."""
        height, width = pixels.shape[:2]
        rows = pixels.reshape(height, -1)
        padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
        return self.store.types[IMAGE](
            header=self._header(nanoseconds),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=padded.shape[1],
            data=np.ascontiguousarray(padded).ravel(),
        )

    def compressed(self, nanoseconds: int, rgb: NDArray[np.uint8], ending: str = ".png") -> Any:
        done, data = cv2.imencode(ending, np.ascontiguousarray(rgb[:, :, ::-1]))
        assert done
        format = f"bgr8; {'png' if ending == '.png' else 'jpeg'} compressed bgr8"
        return self.store.types[COMPRESSED](
            header=self._header(nanoseconds), format=format, data=data.ravel()
        )

    def info(self, camera_matrix: Sequence[float], **changed: Any) -> Any:
        """Of a camera of 64x48, without distortion unless that is given."""
        region = self.store.types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=changed.pop("x_offset", 0),
            y_offset=changed.pop("y_offset", 0),
            height=changed.pop("roi_height", 0),
            width=changed.pop("roi_width", 0),
            do_rectify=False,
        )
        k = np.array(camera_matrix, dtype=np.float64)
        p = np.array(changed.pop("p", [*k[:3], 0, *k[3:6], 0, *k[6:], 0]), dtype=np.float64)
        numbers = {
            "d": np.array(changed.pop("d", []), dtype=np.float64),
            "k": k,
            "r": np.eye(3).ravel(),
            "p": p,
        }
        if self.ros1:
            numbers = {name.upper(): value for name, value in numbers.items()}
        fields: dict[str, Any] = {"height": 48, "width": 64, "distortion_model": "plumb_bob"}
        fields |= {"binning_x": 0, "binning_y": 0, **changed}
        return self.store.types[INFO](header=self._header(0), roi=region, **numbers, **fields)

    def imu(self) -> Any:
        """Something that is no image."""
        time = self.store.types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
        kind = "sensor_msgs/msg/TimeReference"
        return self.store.types[kind](header=self._header(1), time_ref=time, source="clock")


def write_bag(
    folder: Path,
    kind: Kind,
    recorded: Sequence[tuple[str, int, Any]],
    **options: Any,
) -> Path:
    """A bag of messages with their topics, and nanoseconds when they were recorded."""
    messages = Messages(kind)
    store = messages.store
    if kind == "bag":
        from rosbags.rosbag1 import Writer as Writer1

        path = folder / "robot.bag"
        writer: Any = Writer1(path)
        if "compression" in options:
            writer.set_compression(Writer1.CompressionFormat[options["compression"]])
        writer.chunk_threshold = options.get("chunk", 1 << 20)
        serialize: Any = store.serialize_ros1
    else:
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        path = folder / "robot"
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
        serialize = store.serialize_cdr
    with writer:
        connections: dict[str, Any] = {}
        for topic, nanoseconds, message in recorded:
            name = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            writer.write(connections[topic], nanoseconds, serialize(message, name))
    return path
