# SPDX-License-Identifier: Apache-2.0
"""A camera that is followed over a WebSocket."""

from __future__ import annotations

import json
import multiprocessing
from typing import Any, Iterator

import numpy as np
import pytest
from batch_room import CAMERA, RoomFolder, wait_until
from fake_desk import FakeDesk
from scenes import ROOM_POSE
from serving import TOKEN, Serving, serving

from gscpe.batch import shelf_order
from gscpe.geometry import pose_difference, se3
from gscpe.poses.hloc import parse_pose
from gscpe.service.limits import Limits
from gscpe.service.service import Service, ServiceSettings

pytest.importorskip("fastapi")
connect = pytest.importorskip("websockets.sync.client").connect

HELLO = json.dumps({"camera": CAMERA.colmap_text()})


@pytest.fixture(scope="module")
def server(room: RoomFolder) -> Iterator[Serving]:
    order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
    settings = ServiceSettings(token=TOKEN, limits=Limits(trackers=1))
    with serving(Service(order, settings, FakeDesk.start)) as server:
        yield server


def address(server: Serving, map_: str = "room") -> str:
    return f"{server.url.replace('http', 'ws')}/v1/maps/{map_}/track"


@pytest.fixture
def socket(server: Serving) -> Iterator[Any]:
    headers = {"Authorization": f"Bearer {TOKEN}"}
    with connect(address(server), additional_headers=headers) as socket:
        yield socket
    wait_until(lambda: server.service.trackers.inside == 0)


def refused(socket: Any) -> str:
    content = json.loads(socket.recv(60))
    return f"{content['status']} {content['error']}"


def test_frames_in_poses_out(socket: Any, room: RoomFolder) -> None:
    """In their order; what came while another was worked on is lost, and counted."""
    photo = (room.path / "photos" / "a.png").read_bytes()
    socket.send(HELLO)
    assert json.loads(socket.recv(120)) == {"status": "ready"}
    answers = []
    socket.send(b"not a photo")
    answers.append(json.loads(socket.recv(120)))
    assert (answers[0]["frame"], answers[0]["status"]) == (0, "failed")
    assert answers[0]["reason"].startswith("frame 0 is not an image")
    sent = 1
    while len(answers) < 200 and answers[-1]["status"] not in ("tracking", "relocalized"):
        socket.send(photo)
        sent += 1
        answers.append(json.loads(socket.recv(120)))
    for _ in range(20):  # faster than they are worked on
        socket.send(photo)
    sent += 20
    while answers[-1]["frame"] < sent - 1:
        answers.append(json.loads(socket.recv(120)))
    numbers = [answer["frame"] for answer in answers]
    assert numbers == sorted(set(numbers))
    assert answers[-1]["frames_lost"] == sent - len(answers)
    truth = se3.exp([0.05, -0.03, 0.0, 0.02, -0.02, 0.03]) @ ROOM_POSE
    found = next(a for a in answers if a["status"] in ("tracking", "relocalized"))
    difference = pose_difference(parse_pose(found["cam_from_world"]), truth)
    assert difference.distance < 0.02
    np.testing.assert_allclose(found["matrix"], parse_pose(found["cam_from_world"]), atol=1e-9)
    assert np.shape(found["covariance"]) == (6, 6)


def test_one_at_a_time_and_what_is_refused(socket: Any, server: Serving) -> None:
    socket.send(HELLO)
    assert json.loads(socket.recv(120))["status"] == "ready"
    hello = json.dumps({"camera": CAMERA.colmap_text(), "token": TOKEN})
    with connect(address(server)) as second:
        second.send(hello)
        assert refused(second) == "503 Busy"
    with connect(address(server)) as stranger:
        stranger.send(HELLO)
        assert refused(stranger) == "401 Unauthorized"
    with connect(address(server)) as stranger:
        stranger.send(json.dumps({"camera": "PINHOLE", "token": TOKEN}))
        assert refused(stranger) == "422 CameraError"
    with connect(address(server)) as stranger:
        stranger.send("[[[")
        assert refused(stranger) == "422 InputError"
    with connect(address(server, "garden")) as stranger:
        assert refused(stranger) == "404 NotFound"
    with (
        pytest.raises(Exception, match="HTTP 403"),
        connect(address(server), additional_headers={"Origin": "http://evil.example"}),
    ):
        pass
    socket.send(json.dumps({"time": "noon"}))
    assert refused(socket) == "422 InputError"


def test_a_tracker_that_is_killed(socket: Any, room: RoomFolder) -> None:
    photo = (room.path / "photos" / "a.png").read_bytes()
    before = set(multiprocessing.active_children())
    socket.send(HELLO)
    assert json.loads(socket.recv(120))["status"] == "ready"
    (tracker,) = set(multiprocessing.active_children()) - before
    tracker.kill()
    socket.send(photo)
    answer = json.loads(socket.recv(120))
    assert (answer["status"], answer["reason"]) == ("lost", "its worker died or hung")
    socket.send(photo)
    assert json.loads(socket.recv(120))["status"] in ("lost", "relocalized")


def test_who_sends_no_frames_makes_room(room: RoomFolder) -> None:
    order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
    settings = ServiceSettings(limits=Limits(upload_seconds=0.5))
    with (
        serving(Service(order, settings, FakeDesk.start)) as hasty,
        connect(address(hasty)) as idle,
    ):
        idle.send(HELLO)
        assert json.loads(idle.recv(120))["status"] == "ready"
        assert refused(idle) == "408 TooSlow"
        wait_until(lambda: hasty.service.trackers.inside == 0)
