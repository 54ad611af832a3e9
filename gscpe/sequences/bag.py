# SPDX-License-Identifier: Apache-2.0
"""Robots' recordings, ROS 1 and 2 bags, through rosbags: the frames of one of their topics."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Iterator

from gscpe.errors import CameraError, MissingDependencyError, PhotoError, SequenceError
from gscpe.geometry.camera import Camera
from gscpe.sequences.camera import camera_of_size
from gscpe.sequences.damaged_bag import DamagedBag, is_bag_file
from gscpe.sequences.frame import Frame, Frames
from gscpe.sequences.ros_messages import (
    CAMERA_INFO,
    COMPRESSED,
    IMAGE,
    check_encoding,
    image_of,
    nanoseconds_of,
    read_ros_camera,
    read_ros_image,
)

BAG_ENDINGS = {".bag", ".db3", ".mcap"}
_RECTIFIED = re.compile(r"(^|_)rect(ified)?(_|$)")  # image_rect, image_rect_color
_SHOWN = 12


def is_bag(path: Path) -> bool:
    """Whether a file, or a folder, is a bag, by its first bytes or by the files in it."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or bool(_storage_files(path))
    return is_bag_file(path)


class BagFrames(Frames):
    """The images of one topic, in the order in which they were recorded.

    A frame's time is that of the message's header, when the picture was taken (where that is 0,
    when it was recorded), and it is named by it. What is left of a bag that is cut off is read.

    Args:
        path: of a ``.bag``; or of a ROS 2 recording, folder or file (``.db3``, ``.mcap``).
        topic: of Image or CompressedImage; None: the only one.
        camera: that took the images; None: as the ``camera_info`` beside the topic says.

    Raises:
        SequenceError: it is no bag, or damaged; there is no such topic, or are several; images are
            of an encoding that is not known.
        CameraError: there is no camera_info, or it is not a camera that gscpe knows; or images
            have another shape than the camera.
        MissingDependencyError: rosbags is not installed.
    """

    def __init__(
        self, path: str | Path, topic: str | None = None, camera: Camera | None = None
    ) -> None:
        self._path = Path(path)
        with _open_bag(self._path) as bag:
            topics = bag.topics
            self._topic = _choose_topic(topic, topics, self._path)
            self.length = bag.count(self._topic)
            first = next((message for _, message in bag.messages(self._topic)), None)
            if first is None:
                raise SequenceError(
                    f"{self._path}: topic {self._topic} has no messages{bag.because()}"
                )
            check_encoding(first, self._topic)
            if camera is None:
                camera = _camera_beside(bag, self._topic, self._path)
        self.description = f"bag {self._path.name}, topic {self._topic}"
        try:
            height, width = image_of(first).shape[:2]
            camera = camera_of_size(camera, (width, height), f"{self._path}, {self._topic}")
        except PhotoError:
            pass  # a damaged image; others may be whole
        self._camera = camera

    def __iter__(self) -> Iterator[Frame]:
        self.trouble = None
        with _open_bag(self._path) as bag:
            count = 0
            for recorded, message in bag.messages(self._topic):
                count += 1
                taken = nanoseconds_of(message, recorded)
                image, trouble = None, None
                try:
                    image = read_ros_image(message, self._topic)
                    self._camera.check_fits(image.shape, "the image")
                except (PhotoError, CameraError, SequenceError) as error:
                    image, trouble = None, str(error)
                name = f"{taken // 10**9}.{taken % 10**9:09d}"
                yield Frame(name, taken / 10**9, image, self._camera, trouble)
            if bag.damage is not None:
                self.trouble = (
                    f"{self._path} is cut off, or damaged, after {count} images of {self._topic} "
                    f"({bag.damage})"
                )


class _Bag:
    """An open bag, whole or damaged, with the same face.

    Attributes:
        topics: message type by topic.
        damage: what is wrong with the bag, once that was noticed.
    """

    def __init__(self, path: Path) -> None:
        self._reader: Any = None
        self._damaged: DamagedBag | None = None
        self.damage: str | None = None
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise MissingDependencyError(
                f"{path} is a ROS bag, which needs rosbags: pip install 'gscpe[ros]'"
            ) from error
        store = get_typestore(Stores.LATEST)  # for old ROS 2 bags, which have no definitions
        files = _files_to_read(path)
        try:
            reader = AnyReader(files, default_typestore=store)
            reader.open()
        except MemoryError:
            raise
        except Exception as error:  # struct.error, zlib.error, AssertionError, ... of damaged files
            self._damaged = DamagedBag(files, path)
            # Or what rosbags did not like is another topic's business.
            self.damage = None if self._damaged.complete else _first_line(error)
            self.topics = self._damaged.topics
            return
        self._reader = reader
        self.topics = {connection.topic: connection.msgtype for connection in reader.connections}

    def count(self, topic: str) -> int | None:
        """How many messages a topic has; None where that is not known."""
        if self._reader is None:
            return None
        return sum(int(c.msgcount) for c in self._reader.connections if c.topic == topic)

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Nanoseconds when it was recorded, and message, until the end of what can be read."""
        if self._damaged is not None:
            yield from self._damaged.messages(topic)
            return
        connections = [c for c in self._reader.connections if c.topic == topic]
        try:
            for connection, nanoseconds, data in self._reader.messages(connections):
                yield nanoseconds, self._reader.deserialize(data, connection.msgtype)
        except MemoryError:
            raise
        except Exception as error:  # whatever the bytes of a damaged file lead to
            self.damage = _first_line(error)

    def because(self) -> str:
        """What is wrong, for the end of a sentence."""
        return "" if self.damage is None else f"; it is cut off, or damaged ({self.damage})"

    def __enter__(self) -> _Bag:
        return self

    def __exit__(self, *_: object) -> None:
        if self._reader is not None:
            self._reader.close()


def _open_bag(path: Path) -> _Bag:
    if not path.exists():
        raise SequenceError(f"there is no bag {path}")
    return _Bag(path)


def _files_to_read(path: Path) -> list[Path]:
    """What rosbags takes: a folder with metadata, or else the files of a folder without (as a
    recorder that was killed leaves it)."""
    if not path.is_dir() or (path / "metadata.yaml").is_file():
        return [path]
    return _storage_files(path)


def _storage_files(folder: Path) -> list[Path]:
    files = (path for path in sorted(folder.iterdir()) if path.suffix in BAG_ENDINGS)
    return [path for path in files if path.is_file()]


def _choose_topic(wanted: str | None, topics: dict[str, str], path: Path) -> str:
    pictures = {
        topic: kind
        for topic, kind in sorted(topics.items())
        if kind in (IMAGE, COMPRESSED) and not topic.lower().endswith("compresseddepth")
    }
    listed = ", ".join(pictures)
    if wanted is not None:
        for topic, kind in topics.items():
            if topic.strip("/") == wanted.strip("/"):
                if kind not in (IMAGE, COMPRESSED):
                    raise SequenceError(
                        f"{path}: {topic} holds {kind}, not images"
                        + (f"; those are in {listed}" if listed else "")
                    )
                return topic
        raise SequenceError(
            f"{path} has no topic {wanted}"
            + (f"; those with images are {listed}" if listed else "; it has no images at all")
        )
    if not pictures:
        others = [f"{topic} ({kind})" for topic, kind in sorted(topics.items())]
        more = f", and {len(others) - _SHOWN} more" if len(others) > _SHOWN else ""
        what = f"; its topics are {', '.join(others[:_SHOWN])}{more}" if others else ""
        raise SequenceError(
            f"{path} holds no images (sensor_msgs/Image or sensor_msgs/CompressedImage){what}"
        )
    if len(pictures) > 1:
        raise SequenceError(f"{path} has images in several topics; say which (--topic): {listed}")
    return next(iter(pictures))


def _camera_beside(bag: _Bag, topic: str, path: Path) -> Camera:
    """Of the camera_info in the namespace of the topic; of image_transport's ``/compressed``, in
    that of the raw topic."""
    parts = topic.split("/")
    if bag.topics[topic] == COMPRESSED and len(parts) > 2:
        parts = parts[:-1]
    beside = "/".join([*parts[:-1], "camera_info"])
    if bag.topics.get(beside) != CAMERA_INFO:
        raise CameraError(
            f"{path} has no calibration of {topic} (there is no {beside}): give --camera"
        )
    message = next((message for _, message in bag.messages(beside)), None)
    if message is None:
        raise CameraError(f"{path}: {beside} has no messages: give --camera")
    return read_ros_camera(message, beside, rectified=_RECTIFIED.search(parts[-1]) is not None)


def _first_line(error: Exception) -> str:
    text = str(error) or type(error).__name__
    # rosbags puts one error's arguments into the text of another.
    return text.splitlines()[0].replace("('", "").replace("',)", "").rstrip(".")
