# SPDX-License-Identifier: Apache-2.0
"""What is left of bags whose index is missing, as after a crash or a full disk: their messages one
after the other, up to where the file ends.

https://wiki.ros.org/Bags/Format/2.0, https://mcap.dev/spec; ROS 2's ``.db3`` is SQLite.
"""

from __future__ import annotations

import bz2
import sqlite3
import struct
import sys
from contextlib import closing
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Iterator, Sequence

from gscpe.errors import SequenceError
from gscpe.given import real_path

_ROS1, _MCAP, _SQLITE = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\x00"
_MOST_BYTES = 2**31  # of a record


@dataclass(frozen=True)
class Recorded:
    """A message as it is stored.

    Attributes:
        topic, kind: its topic, and type as in ROS 2 (``sensor_msgs/msg/Image``).
        nanoseconds: when it was recorded.
        data: serialized; None: the topic is only announced.
        ros1: whether as by ROS 1.
    """

    topic: str
    kind: str
    nanoseconds: int = 0
    data: bytes | None = None
    ros1: bool = False


def is_bag_file(path: Path) -> bool:
    """Whether a file is a bag, by its first bytes."""
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError:
        return False
    return start.startswith((_ROS1, _MCAP, _SQLITE))


class DamagedBag:
    """The messages that can still be read.

    Args:
        files: of the bag.
        path: that the user gave, for errors.

    Attributes:
        topics: message type by topic.
        complete: whether all files could be read up to their very end; so what is wrong is not
            that they are cut off.

    Raises:
        SequenceError: nothing at all can be read.
    """

    def __init__(self, files: Sequence[Path], path: Path) -> None:
        self._files = [file for file in files if file.is_file()] or sorted(
            file for file in path.glob("*") if is_bag_file(file)
        )
        self.topics: dict[str, str] = {}
        self.complete = bool(self._files)
        for recorded in self._all():
            self.topics[recorded.topic] = recorded.kind
        if not self.topics:
            raise SequenceError(
                f"{path} cannot be read: it is no bag of ROS 1 or 2, or damaged from its beginning"
            )

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Nanoseconds when it was recorded, and message, of a topic, as they come in the file.

        The definitions of camera messages are those of ROS, and not looked up in the file.
        """
        from rosbags.typesys import Stores, get_typestore

        ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.LATEST)
        for recorded in self._all():
            if recorded.topic == topic and recorded.data is not None:
                read = ros1.deserialize_ros1 if recorded.ros1 else ros2.deserialize_cdr
                yield recorded.nanoseconds, read(recorded.data, recorded.kind)

    def _all(self) -> Iterator[Recorded]:
        for path in self._files:
            with path.open("rb") as file:
                start = file.read(16)
                try:
                    if start.startswith(_ROS1):
                        file.seek(len(_ROS1))
                        yield from _ros1_messages(file, {})
                    elif start.startswith(_MCAP):
                        file.seek(len(_MCAP))
                        yield from _mcap_messages(file, {}, {})
                    elif start.startswith(_SQLITE):
                        yield from _sqlite_messages(path)
                except _ENDS:
                    self.complete = False


class _CutOffError(Exception):
    """The file ends in a record, or before its index."""


_ENDS = (
    _CutOffError,
    struct.error,
    sqlite3.DatabaseError,
    OSError,
    EOFError,
    ValueError,
    RuntimeError,
    KeyError,
)
"""What the end of a file that was cut off leads to; decompressors raise the middle
ones, and a topic may have been announced in a part that is missing."""


def _read(file: BinaryIO, size: int) -> bytes:
    data = file.read(size) if size <= _MOST_BYTES else b""
    if len(data) != size:
        raise _CutOffError
    return data


def _ros1_messages(file: BinaryIO, topics: dict[int, Recorded]) -> Iterator[Recorded]:
    """Of a file or of a chunk of it; ``topics`` by number of their connection."""
    has_index = isinstance(file, BytesIO)
    while head := file.read(4):
        if len(head) < 4:
            raise _CutOffError
        fields = _ros1_fields(_read(file, *struct.unpack("<I", head)))
        (size,) = struct.unpack("<I", _read(file, 4))
        kind = fields.get(b"op", b"\0")[0]
        if kind == 5 and fields[b"compression"] == b"none":
            continue  # its records follow, up to where it was cut
        data = _read(file, size)
        if kind == 5:
            yield from _ros1_messages(BytesIO(_ros1_chunk(fields, data)), topics)
        elif kind == 7:
            (number,) = struct.unpack("<I", fields[b"conn"])
            about = _ros1_fields(data)
            name = about[b"type"].decode().replace("/", "/msg/", 1)
            topic = fields[b"topic"].decode()
            topics[number] = Recorded(topic, name, ros1=True)
            yield topics[number]
        elif kind == 2:
            (number,) = struct.unpack("<I", fields[b"conn"])
            seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
            recorded = seconds * 10**9 + nanoseconds
            yield replace(topics[number], nanoseconds=recorded, data=data)
        has_index |= kind == 6
    if not has_index:
        raise _CutOffError


def _ros1_fields(header: bytes) -> dict[bytes, bytes]:
    fields, at = {}, 0
    while at < len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        fields[name] = value
        at += 4 + size
    return fields


def _ros1_chunk(fields: dict[bytes, bytes], data: bytes) -> bytes:
    compression = fields[b"compression"]
    if compression == b"bz2":
        return bz2.decompress(data)
    if compression == b"lz4":
        from lz4.frame import decompress

        return bytes(decompress(data))
    return data


def _mcap_messages(
    file: BinaryIO, schemas: dict[int, str], channels: dict[int, Recorded]
) -> Iterator[Recorded]:
    while head := file.read(9):
        if len(head) < 9:
            raise _CutOffError
        kind, size = struct.unpack("<BQ", head)
        if kind == 0x06:
            _read(file, 28)
            compression = _mcap_text(file)
            (packed,) = struct.unpack("<Q", _read(file, 8))
            if compression:  # else its records follow, up to where it was cut
                chunk = BytesIO(_mcap_chunk(compression, _read(file, packed)))
                yield from _mcap_messages(chunk, schemas, channels)
            continue
        data = BytesIO(_read(file, size))
        if kind == 0x02:  # the footer
            return
        if kind == 0x03:
            (number,) = struct.unpack("<H", _read(data, 2))
            schemas[number] = _mcap_text(data)
        elif kind == 0x04:
            number, schema = struct.unpack("<HH", _read(data, 4))
            channels[number] = Recorded(_mcap_text(data), schemas.get(schema, ""))
            yield channels[number]
        elif kind == 0x05:
            number, _, recorded, _ = struct.unpack("<HIQQ", _read(data, 22))
            yield replace(channels[number], nanoseconds=recorded, data=data.read())
    if not isinstance(file, BytesIO):
        raise _CutOffError


def _mcap_text(data: BinaryIO) -> str:
    return _read(data, *struct.unpack("<I", _read(data, 4))).decode()


def _mcap_chunk(compression: str, packed: bytes) -> bytes:
    if compression == "lz4":
        from lz4.frame import decompress

        return bytes(decompress(packed))
    if compression == "zstd":
        if sys.version_info >= (3, 14):
            from compression import zstd
        else:
            from backports import zstd

        try:
            return bytes(zstd.decompress(packed))
        except zstd.ZstdError as error:
            raise _CutOffError from error
    return packed


def _sqlite_messages(path: Path) -> Iterator[Recorded]:
    """In the order in which they were written: the index of their times is at the file's end."""
    uri = f"{real_path(path).as_uri()}?mode=ro&immutable=1"
    with closing(sqlite3.connect(uri, uri=True)) as connection:
        # Otherwise, nothing at all is read of a file that is shorter than it says.
        connection.execute("PRAGMA writable_schema = ON")
        topics = {
            number: Recorded(name, kind)
            for number, name, kind in connection.execute("SELECT id, name, type FROM topics")
        }
        yield from topics.values()
        rows = connection.execute("SELECT topic_id, timestamp, data FROM messages NOT INDEXED")
        for number, recorded, data in rows:
            yield replace(topics[number], nanoseconds=recorded, data=data)
