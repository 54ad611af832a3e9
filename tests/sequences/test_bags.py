# SPDX-License-Identifier: Apache-2.0
"""Frames of ROS 1 and 2 bags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bags import KINDS, Kind, Messages, write_bag
from helpers import distorted_projection, random_pose
from numpy.typing import NDArray

from gscpe.errors import CameraError, MissingDependencyError, SequenceError
from gscpe.geometry import Camera
from gscpe.sequences import open_frames

START = 1_700_000_000_250_000_000
STEP = 100_000_000
K = [50.0, 0, 31.5, 0, 51.0, 23.5, 0, 0, 1]
CAMERA = Camera.pinhole(64, 48, fx=50, fy=51, cx=32, cy=24)


def picture(number: int = 0, width: int = 64, height: int = 48) -> NDArray[np.uint8]:
    """Smooth, and other in every channel."""
    v, u = np.mgrid[:height, :width] / 10.0
    waves = [np.sin(u + number), np.cos(v + 0.5 * u), np.sin(v - number)]
    return np.asarray(np.rint(127 + 100 * np.stack(waves, axis=2)), dtype=np.uint8)


def film(messages: Messages, count: int = 4, topic: str = "/cam/image") -> list[Any]:
    return [
        (topic, START + i * STEP + 7, messages.image(START + i * STEP, picture(i), "rgb8"))
        for i in range(count)
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_images_times_and_camera(kind: Kind, tmp_path: Path) -> None:
    """Times are those of the pictures; the camera, that of the topic beside."""
    messages = Messages(kind)
    recorded = [("/clock", START, messages.imu()), ("/cam/camera_info", START, messages.info(K))]
    path = write_bag(tmp_path, kind, recorded + film(messages))
    frames = open_frames(path)
    assert (frames.length, frames.live) == (4, False)
    for _ in range(2):  # it can be read again
        read = list(frames)
        assert [frame.name for frame in read][:2] == [
            "1700000000.250000000",
            "1700000000.350000000",
        ]
        assert [frame.time for frame in read] == [(START + i * STEP) / 10**9 for i in range(4)]
        assert {frame.camera for frame in read} == {CAMERA}
        for number, frame in enumerate(read):
            assert frame.image is not None
            np.testing.assert_array_equal(frame.image, picture(number))
        assert frames.trouble is None
    if kind != "bag":  # the file without its folder's metadata.yaml
        (file,) = path.glob(f"*.{kind}")
        assert len(list(open_frames(file))) == 4


def test_a_robot_with_a_camera_calibrated_elsewhere(tmp_path: Path) -> None:
    """As FAST-LIVO2's: JPEG at 10 Hz, the calibration in a file, of larger pictures."""
    messages = Messages("bag")
    images = [messages.compressed(START + i * STEP, picture(i), ".jpg") for i in range(3)]
    recorded = [("/left_camera/image/compressed", START + i, m) for i, m in enumerate(images)]
    path = write_bag(tmp_path, "bag", recorded, compression="LZ4")
    with pytest.raises(CameraError, match=r"no /left_camera/camera_info.*--camera"):
        open_frames(path)
    twice = CAMERA.resized(128, 96)
    frames = list(open_frames(path, twice))
    assert {frame.camera for frame in frames} == {CAMERA}
    assert [frame.time for frame in frames] == [(START + i * STEP) / 10**9 for i in range(3)]
    for number, frame in enumerate(frames):
        assert frame.image is not None
        assert np.abs(frame.image.astype(int) - picture(number)).mean() < 4
    with pytest.raises(CameraError, match="64x48, but its camera is 64x64"):
        open_frames(path, CAMERA.resized(64, 64))


def mosaic(rgb: NDArray[np.uint8], pattern: str) -> NDArray[np.uint8]:
    """What a sensor sees through colour filters: letters row by row."""
    raw = np.empty(rgb.shape[:2], dtype=np.uint8)
    for i, letter in enumerate(pattern):
        row, column = divmod(i, 2)
        raw[row::2, column::2] = rgb[row::2, column::2, "rgb".index(letter)]
    return raw


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns(pattern: str, tmp_path: Path) -> None:
    messages = Messages("bag")
    raw = mosaic(picture(), pattern)
    message = messages.image(START, raw, f"bayer_{pattern}8")
    path = write_bag(tmp_path, "bag", [("/image", 1, message)])
    (frame,) = open_frames(path, CAMERA)
    assert frame.image is not None
    error = np.abs(frame.image.astype(int) - picture())[2:-2, 2:-2]
    assert error.max() < 8
    assert error.mean() < 1


@pytest.mark.parametrize(
    ("encoding", "conversion"),
    [
        ("rgb8", None),
        ("bgr8", cv2.COLOR_RGB2BGR),
        ("8UC3", cv2.COLOR_RGB2BGR),
        ("rgba8", cv2.COLOR_RGB2RGBA),
        ("bgra8", cv2.COLOR_RGB2BGRA),
        ("mono8", cv2.COLOR_RGB2GRAY),
    ],
)
def test_encodings(encoding: str, conversion: int | None, tmp_path: Path) -> None:
    """Rows may be padded."""
    messages = Messages("db3")
    rgb = picture()
    stored = rgb if conversion is None else np.asarray(cv2.cvtColor(rgb, conversion), np.uint8)
    message = messages.image(START, stored, encoding, padding=5)
    (frame,) = open_frames(write_bag(tmp_path, "db3", [("/image", 1, message)]), CAMERA)
    expected = np.dstack([stored] * 3) if encoding == "mono8" else rgb
    np.testing.assert_array_equal(frame.image, expected)


@pytest.mark.parametrize(("encoding", "luminance"), [("yuv422", 1), ("yuv422_yuy2", 0)])
def test_grey_as_yuv(encoding: str, luminance: int, tmp_path: Path) -> None:
    messages = Messages("bag")
    grey = np.linspace(30, 220, 64 * 48).reshape(48, 64)
    stored = np.full((48, 64, 2), 128, dtype=np.uint8)
    stored[:, :, luminance] = np.rint(16 + grey * 219 / 255)
    message = messages.image(START, stored, encoding)
    (frame,) = open_frames(write_bag(tmp_path, "bag", [("/image", 1, message)]), CAMERA)
    assert frame.image is not None
    assert np.abs(frame.image - grey[:, :, None]).max() < 2


def camera_of(tmp_path: Path, topic: str = "/cam/image", **changed: Any) -> Camera:
    messages = Messages("bag")
    size = changed.pop("size", (64, 48))
    image = messages.image(START, picture(0, *size), "rgb8")
    info = messages.info(changed.pop("k", K), **changed)
    path = write_bag(tmp_path, "bag", [("/cam/camera_info", 1, info), (topic, 2, image)])
    (frame,) = open_frames(path)
    return frame.camera


def test_lens_distortion(tmp_path: Path, rng: np.random.Generator) -> None:
    """Pixels agree with OpenCV's, half a pixel apart."""
    d = [-0.2, 0.05, 0.001, -0.002, 0.01]
    camera = camera_of(tmp_path, d=d)
    pose = random_pose(rng)
    points = rng.uniform((-0.4, -0.4, 1.6), (0.4, 0.4, 2.4), (20, 3))
    world = (points - pose[:3, 3]) @ pose[:3, :3]
    rotation, _ = cv2.Rodrigues(pose[:3, :3])
    theirs, _ = cv2.projectPoints(world, rotation, pose[:3, 3], np.reshape(K, (3, 3)), np.array(d))
    np.testing.assert_allclose(
        distorted_projection(camera, points), theirs.reshape(-1, 2) + 0.5, atol=1e-9
    )


def test_fisheye_rectified_binned_and_cropped(tmp_path: Path) -> None:
    camera = camera_of(tmp_path, d=[0.1, 0.2, 0.3, 0.4], distortion_model="equidistant")
    assert camera == Camera.parse("OPENCV_FISHEYE 64 48 50 51 32 24 0.1 0.2 0.3 0.4")
    (tmp_path / "robot.bag").unlink()
    p = [40.0, 0, 30.5, 0, 0, 41.0, 20.5, 0, 0, 0, 1, 0]
    camera = camera_of(tmp_path, "/cam/image_rect_color", d=[0.1, 0, 0, 0, 0], p=p)
    assert camera == Camera.pinhole(64, 48, fx=40, fy=41, cx=31, cy=21)
    (tmp_path / "robot.bag").unlink()
    halved: dict[str, Any] = {"binning_x": 2, "binning_y": 2, "width": 128, "height": 96}
    camera = camera_of(tmp_path, k=[100.0, 0, 63.5, 0, 102.0, 47.5, 0, 0, 1], **halved)
    assert camera == CAMERA
    (tmp_path / "robot.bag").unlink()
    cut: dict[str, Any] = {"x_offset": 10, "y_offset": 4, "roi_width": 64, "roi_height": 48}
    camera = camera_of(tmp_path, k=[50.0, 0, 41.5, 0, 51.0, 27.5, 0, 0, 1], width=90, **cut)
    assert camera == CAMERA


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"k": [0.0] * 9}, "not calibrated.*--camera"),
        ({"d": [0.1, 0.2], "distortion_model": "fov"}, "'fov' is not known.*--camera"),
        ({"d": [0.1] * 14, "distortion_model": "rational_polynomial"}, "14 coefficients"),
    ],
)
def test_calibrations_that_cannot_be_used(
    changed: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(CameraError, match=words):
        camera_of(tmp_path, **changed)


def test_topics(tmp_path: Path) -> None:
    messages = Messages("bag")
    recorded = [
        ("/clock", 1, messages.imu()),
        *film(messages, 2, "/left/image_raw"),
        *film(messages, 3, "/right/image_raw"),
    ]
    path = write_bag(tmp_path, "bag", recorded)
    with pytest.raises(SequenceError, match=r"--topic\): /left/image_raw, /right/image_raw"):
        open_frames(path, CAMERA)
    for topic in ("/right/image_raw", "right/image_raw"):
        assert len(list(open_frames(path, CAMERA, topic=topic))) == 3
    with pytest.raises(SequenceError, match=r"no topic /middle; those with images are /left/"):
        open_frames(path, CAMERA, topic="/middle")
    with pytest.raises(SequenceError, match=r"/clock holds sensor_msgs/msg/TimeReference, not"):
        open_frames(path, CAMERA, topic="/clock")


@pytest.mark.parametrize("kind", KINDS)
def test_no_images(kind: Kind, tmp_path: Path) -> None:
    path = write_bag(tmp_path, kind, [("/clock", 1, Messages(kind).imu())])
    with pytest.raises(SequenceError, match=r"holds no images.*topics are /clock \(sensor_msgs/"):
        open_frames(path, CAMERA)
    with pytest.raises(SequenceError, match="it has no images at all"):
        open_frames(path, CAMERA, topic="/image")


def test_images_of_another_kind(tmp_path: Path) -> None:
    """Depth is no picture; one message that is damaged does not spoil the others."""
    messages = Messages("bag")
    depth = messages.image(START, np.zeros((48, 128), np.uint8), "16UC1")
    path = write_bag(tmp_path, "bag", [("/depth", 1, depth)])
    with pytest.raises(SequenceError, match=r"'16UC1', which is not known \(known: 8uc1, "):
        open_frames(path, CAMERA)
    path.unlink()
    recorded = film(messages, 3)
    recorded[1][2].data = recorded[1][2].data[:100]
    recorded.append(
        ("/cam/image", START + 10**9, messages.image(START + 10**9, picture(0, 32), "rgb8"))
    )
    first, second, third, fourth = open_frames(write_bag(tmp_path, "bag", recorded), CAMERA)
    assert first.image is not None and third.image is not None
    assert second.image is None and "damaged" in str(second.trouble)
    assert fourth.image is None and "32x48, but its camera is 64x48" in str(fourth.trouble)


def test_without_a_time_in_the_header(tmp_path: Path) -> None:
    messages = Messages("bag")
    image = messages.image(0, picture(), "rgb8")
    (frame,) = open_frames(write_bag(tmp_path, "bag", [("/image", START, image)]), CAMERA)
    assert frame.time == 1_700_000_000.25


def test_time_that_runs_backwards(tmp_path: Path) -> None:
    messages = Messages("bag")
    order = [0, 1, 3, 2]
    recorded = [
        ("/image", START + i, messages.image(START + n * STEP, picture(n), "rgb8"))
        for i, n in enumerate(order)
    ]
    path = write_bag(tmp_path, "bag", recorded)
    frames = iter(open_frames(path, CAMERA))
    assert [next(frames).stamp for _ in range(3)][2] == "1700000000.55"
    with pytest.raises(SequenceError, match=r"0\.1 s before that of 1700000000\.55.*--rate"):
        next(frames)
    assert [frame.time for frame in open_frames(path, CAMERA, rate=5.0)] == [0, 0.2, 0.4, 0.6]


@pytest.mark.parametrize("share", [0.5, 0.9])
@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_that_is_cut_off(kind: Kind, share: float, tmp_path: Path) -> None:
    """What is there is read, and it says so."""
    messages = Messages(kind)
    recorded = [("/cam/camera_info", START, messages.info(K)), *film(messages, 30)]
    path = write_bag(tmp_path, kind, recorded)
    file = path if kind == "bag" else next(path.glob(f"*.{kind}"))
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    frames = open_frames(path)
    read = list(frames)
    assert share * 30 - 6 < len(read) <= share * 30 + 1
    for number, frame in enumerate(read):
        np.testing.assert_array_equal(frame.image, picture(number))
    assert f"cut off, or damaged, after {len(read)} images of /cam/image" in str(frames.trouble)
    assert {frame.camera for frame in read} == {CAMERA}


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_a_compressed_recording_without_its_end(compression: str, tmp_path: Path) -> None:
    """An MCAP as ROS 2 leaves it when the battery is empty: a chunk, and half of another."""
    from rosbags.rosbag2 import storage_mcap

    messages = Messages("mcap")
    path = write_bag(tmp_path, "mcap", film(messages, 12))
    (file,) = path.glob("*.mcap")
    data = file.read_bytes()
    at = data.index(b"\x06", 8 + 9)  # behind magic and header
    length = int.from_bytes(data[at + 1 : at + 9], "little")
    record = data[at : at + 9 + length]
    packed = mcap_with(record, compression)
    file.write_bytes(data[:at] + packed + (packed[: len(packed) // 2] if compression else b"\x05"))
    assert storage_mcap.DECOMPRESSORS.keys() == {"", "lz4", "zstd"}
    frames = open_frames(path, CAMERA)
    assert len(list(frames)) == 12
    assert "cut off" in str(frames.trouble)


def mcap_with(record: bytes, compression: str) -> bytes:
    """A chunk record, compressed otherwise."""
    import struct
    import sys

    import lz4.frame

    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd

    start = record[9 : 9 + 28]
    (name,) = struct.unpack_from("<I", record, 9 + 28)
    was = record[9 + 32 : 9 + 32 + name].decode()
    body = record[9 + 32 + name + 8 :]
    plain: Any = {"": bytes, "lz4": lz4.frame.decompress, "zstd": zstd.decompress}[was](body)
    pack: Any = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstd.compress}[compression]
    body = bytes(pack(plain))
    name_now = compression.encode()
    inner = start + struct.pack("<I", len(name_now)) + name_now
    inner += struct.pack("<Q", len(body)) + body
    return struct.pack("<BQ", 6, len(inner)) + inner


def test_a_compressed_bag_without_its_end(tmp_path: Path) -> None:
    """What is in whole chunks is read."""
    for number, compression in enumerate(("LZ4", "BZ2")):
        folder = tmp_path / str(number)
        folder.mkdir()
        messages = Messages("bag")
        bag = write_bag(folder, "bag", film(messages, 30), chunk=50_000, compression=compression)
        data = bag.read_bytes()
        bag.write_bytes(data[: len(data) // 2])
        frames = open_frames(bag, CAMERA)
        count = len(list(frames))
        assert 6 <= count <= 20
        assert f"after {count} images" in str(frames.trouble)


def test_what_is_no_bag(tmp_path: Path) -> None:
    path = tmp_path / "robot.bag"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(SequenceError, match="is not a ROS bag"):
        open_frames(path, CAMERA)
    path.write_bytes(b"#ROSBAG V2.0\n" + bytes(200))
    with pytest.raises(SequenceError, match="damaged from its beginning"):
        open_frames(path, CAMERA)


def test_without_rosbags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(tmp_path, "bag", film(Messages("bag"), 1))
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'gscpe\[ros\]'"):
        open_frames(path, CAMERA)
