# SPDX-License-Identifier: Apache-2.0
"""From what a user names to frames."""

from __future__ import annotations

from pathlib import Path

from gscpe.errors import CameraError, SequenceError, SettingsError
from gscpe.geometry.camera import Camera
from gscpe.scene.query_list import PHOTO_ENDINGS
from gscpe.sequences.bag import BagFrames, is_bag
from gscpe.sequences.device import DeviceFrames
from gscpe.sequences.frame import Frames, InOrder
from gscpe.sequences.photos import folder_frames, list_frames
from gscpe.sequences.video import VIDEO_ENDINGS, VideoFrames

DEVICE = "device:"

_KINDS = (
    f"a video ({', '.join(sorted(VIDEO_ENDINGS))}), a folder of photos, a list of them (name MODEL "
    f"width height params), a ROS bag (.bag, .db3, .mcap, or its folder), or {DEVICE}0"
)


def open_frames(
    source: str | Path,
    camera: Camera | None = None,
    *,
    images: str | Path | None = None,
    times: str | Path | None = None,
    topic: str | None = None,
    rate: float | None = None,
) -> Frames:
    """The frames of a video, of a folder or list of photos, of a ROS bag or of a camera.

    Args:
        source: a video file; a folder of photos, in the order of the numbers in their names, or of
            their times; a list of photos (hloc's, or names alone), in its order; a ``.bag``,
            ``.db3`` or ``.mcap``, or the folder of a ROS 2 bag; or ``device:0``, a camera at this
            machine.
        camera: that took the frames. Lists may have cameras of their own, and a bag a
            ``camera_info`` beside the topic; all others need one. Where frames are larger or
            smaller by one factor, it is scaled.
        images: folder of a list's photos; None: that of the list.
        times: file of the photos' times, lines of ``name seconds``, or of seconds alone; None:
            their names, where these are times.
        topic: of a bag's images; None: the only one.
        rate: frames a second, in place of all times.

    Raises:
        SequenceError: it is none of these, or cannot be read; the message says what to do.
        CameraError: no camera is known, or frames have another shape than it.
        QueryListError: the list has another form.
        SettingsError: an option does not go with this source, or the rate is not positive.
        MissingDependencyError: it is a bag, and rosbags is not installed.
    """
    if rate is not None and not 0 < rate < float("inf"):
        raise SettingsError(f"a rate must be positive, not {rate:g} frames a second")
    kind = _kind(source)
    for option, value, kinds in (
        ("--images", images, ("list",)),
        ("--times", times, ("list", "folder")),
        ("--topic", topic, ("bag",)),
        ("--rate", rate, ("list", "folder", "video", "bag")),
    ):
        if value is not None and kind not in kinds:
            raise SettingsError(f"{option} does not go with a {kind}, which {source} is")
    return InOrder(_frames(kind, source, camera, images, times, topic), rate)


def _frames(
    kind: str,
    source: str | Path,
    camera: Camera | None,
    images: str | Path | None,
    times: str | Path | None,
    topic: str | None,
) -> Frames:
    if kind == "bag":
        return BagFrames(source, topic, camera)
    if kind == "list":
        return list_frames(source, images, camera, times)
    if camera is None:
        raise CameraError(
            f"the camera of {source} is not known: give it (--camera MODEL,width,height,params..., "
            "or a file). For one photo, gscpe localize MAP PHOTO estimates and prints it"
        )
    if kind == "device":
        return DeviceFrames(str(source)[len(DEVICE) :], camera)
    if kind == "video":
        return VideoFrames(source, camera)
    return folder_frames(source, camera, times)


def _kind(source: str | Path) -> str:
    if str(source).startswith(DEVICE):
        if not str(source)[len(DEVICE) :]:
            raise SequenceError(f"{source} names no device: give {DEVICE}0, or {DEVICE}/dev/video0")
        return "device"
    path = Path(source)
    if not path.exists():
        raise SequenceError(f"there is no {path}; expected {_KINDS}")
    if is_bag(path):
        return "bag"
    if path.is_dir():
        return "folder"
    ending = path.suffix.lower()
    if ending in VIDEO_ENDINGS:
        return "video"
    if ending in (".bag", ".db3", ".mcap"):
        raise SequenceError(f"{path} is not a ROS bag: it does not begin like one; copy it again")
    if ending in PHOTO_ENDINGS:
        raise SequenceError(
            f"{path} is a single photo: give its folder, or localize it (gscpe localize)"
        )
    if _is_text(path):
        return "list"
    raise SequenceError(f"{path} is no sequence that gscpe can read; expected {_KINDS}")


def _is_text(path: Path) -> bool:
    with path.open("rb") as file:
        start = file.read(4096)
    return b"\0" not in start or start[:2] in (b"\xff\xfe", b"\xfe\xff")
