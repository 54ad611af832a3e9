# SPDX-License-Identifier: Apache-2.0
"""A real server of a small map: as the command line answers, whatever is sent to it."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Iterator

import numpy as np
import pytest
from batch_room import CAMERA, QUERIES, RoomFolder, make_room, wait_until
from fake_desk import FakeDesk
from serving import Serving, serving
from test_parts import png_bomb

from gscpe import CameraError, Client, MapError, PhotoError, PoseError, PosePrior, ServiceError
from gscpe.batch import shelf_order
from gscpe.cli.main import main
from gscpe.photos.image_file import decode_image
from gscpe.poses.hloc import parse_pose
from gscpe.service.limits import Limits
from gscpe.service.service import Service, ServiceSettings

httpx = pytest.importorskip("httpx")

TOKEN = "0123456789abcdef0123"
LIMITS = Limits(body_bytes=2_000_000, pixels=1_000_000)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> RoomFolder:
    return make_room(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def server(room: RoomFolder) -> Iterator[Serving]:
    order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
    with serving(Service(order, ServiceSettings(workers=2, limits=LIMITS))) as serving_:
        yield serving_


@pytest.fixture
def client(server: Serving) -> Iterator[Client]:
    with Client(server.url) as client:
        yield client


@pytest.fixture
def fake(room: RoomFolder, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Service]:
    """Services whose workers do what photos say (they need no map)."""
    monkeypatch.setattr("gscpe.service.app.check_photo", lambda *_: (1, 1))

    def make(**settings: Any) -> Service:
        order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
        return Service(order, ServiceSettings(**settings), FakeDesk.start)

    return make


def photo_of(room: RoomFolder, name: str = "a.png") -> bytes:
    return (room.path / "photos" / name).read_bytes()


def without_times(detail: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in detail.items() if key not in ("seconds", "name")}


def post(url: str, data: bytes, **form: str) -> Any:
    address = f"{url}/v1/maps/room/localize"
    return httpx.post(address, files={"photo": ("a.png", data)}, data=form, timeout=120)


def problem(answer: Any, status: int, error: str) -> str:
    """Its detail; it holds nothing of the server's own."""
    assert answer.headers["content-type"] == "application/problem+json"
    content = answer.json()
    assert (answer.status_code, content["status"], content["error"]) == (status, status, error)
    assert set(content) == {"type", "title", "status", "detail", "error"}
    assert not [word for word in ("Traceback", "/tmp", ".py", "gsmap") if word in answer.text]
    return str(content["detail"])


def test_as_the_command_line_says(
    client: Client, room: RoomFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    """In every digit, also where the camera is estimated."""
    for camera in (CAMERA, None):
        photo = room.path / "photos" / "a.png"
        arguments = ["localize", str(room.path / "room.gsmap"), str(photo), "--matcher", "sift"]
        given = [] if camera is None else ["--camera", camera.colmap_text()]
        assert main([*arguments, "--json", *given]) == 0
        expected = json.loads(capsys.readouterr().out)
        answer = client.localize("room", photo, camera)
        assert answer["name"] == "a.png"
        assert without_times(answer) == without_times(expected)
        pose = parse_pose(answer["cam_from_world"])
        np.testing.assert_allclose(answer["matrix"], pose, atol=1e-9)
        assert [each["reason"] for each in answer["attempts"]] == [None]
        assert np.shape(answer["covariance"]) == (6, 6)


def test_many_at_once_are_not_mixed_up(client: Client, room: RoomFolder) -> None:
    photos = {q.name: photo_of(room, q.name) for q in QUERIES[:3]}
    alone = {name: client.localize("room", data, CAMERA) for name, data in photos.items()}
    names = [*photos] * 5
    with ThreadPoolExecutor(len(names)) as pool:
        answers = list(pool.map(lambda name: client.localize("room", photos[name], CAMERA), names))
    for name, answer in zip(names, answers, strict=True):
        assert without_times(answer) == without_times(alone[name])
    assert len({answer["cam_from_world"] for answer in answers}) == 3


def test_a_prior(client: Client, room: RoomFolder) -> None:
    there = parse_pose(client.localize("room", photo_of(room), CAMERA)["cam_from_world"])
    answer = client.localize("room", photo_of(room), CAMERA, PosePrior(there, 0.02, 1.0))
    assert (answer["status"], answer["started_from"]) == ("localized", "tracking")


def test_in_all_maps(client: Client, room: RoomFolder) -> None:
    answer = client.localize(None, photo_of(room), CAMERA)
    assert (answer["map_name"], answer["maps_tried"]) == ("room", ["room"])
    alone = client.localize("room", photo_of(room), CAMERA)
    assert without_times(alone).items() <= without_times(answer).items()
    with pytest.raises(PoseError, match="belongs to one map"):
        client.localize(None, photo_of(room), CAMERA, PosePrior(np.eye(4)))


def test_a_photo_of_elsewhere_is_an_answer(client: Client) -> None:
    import cv2

    noise = np.random.default_rng(0).integers(0, 255, (180, 240, 3), dtype=np.uint8)
    data = bytes(cv2.imencode(".png", noise)[1])
    for camera in (CAMERA, None):
        answer = client.localize("room", data, camera)
        assert (answer["status"], answer["cam_from_world"]) == ("not localized", None)
        assert answer["reason"]


def test_what_cannot_be_used(server: Serving, room: RoomFolder) -> None:
    url, photo = server.url, photo_of(room)
    assert problem(post(url, b"no photo"), 422, "PhotoError").startswith("a.png is not an image")
    assert problem(post(url, photo[:2000]), 422, "PhotoError")
    assert "has 9000x9000 pixels" in problem(post(url, png_bomb(9000, 9000)), 413, "TooLarge")
    assert "has 2000" not in problem(post(url, b"x" * 2_100_000), 413, "TooLarge")
    wrong = post(url, photo, camera="PINHOLE,1,1,1,1,1,1")
    assert "is 240x180, but its camera is 1x1" in problem(wrong, 422, "CameraError")
    assert "of the form" in problem(post(url, photo, camera="PINHOLE"), 422, "CameraError")
    assert "of the form" in problem(post(url, photo, prior="1 2"), 422, "PoseError")
    empty = httpx.post(f"{url}/v1/maps/room/localize")
    assert problem(empty, 422, "PhotoError") == "the form has no file named photo"
    odd = httpx.post(
        f"{url}/v1/maps/room/localize",
        content=b"--x\r\nbroken",
        headers={"Content-Type": "multipart/form-data; boundary=x"},
    )
    assert odd.status_code in (400, 422)
    nowhere = httpx.post(f"{url}/v1/maps/garden/localize", files={"photo": photo})
    assert "there are: room" in problem(nowhere, 404, "NotFound")
    problem(httpx.get(f"{url}/secret"), 404, "NotFound")
    problem(httpx.get(f"{url}/v1/maps/room/localize"), 405, "InputError")
    problem(httpx.get(f"{url}/v1/maps/room/render"), 422, "InputError")


def test_a_body_that_does_not_say_how_long_it_is(server: Serving) -> None:
    def chunks() -> Iterator[bytes]:
        head = b'--x\r\nContent-Disposition: form-data; name="photo"; filename="a.jpg"\r\n\r\n'
        yield head
        for _ in range(30):
            yield b"0" * 100_000

    headers = {"Content-Type": "multipart/form-data; boundary=x"}
    answer = httpx.post(
        f"{server.url}/v1/maps/room/localize", content=chunks(), headers=headers, timeout=60
    )
    problem(answer, 413, "TooLarge")


def test_whoever_is_refused_hears_why(server: Serving) -> None:
    """Also where the answer is ready long before the photo has been sent."""
    for _ in range(20):
        problem(post(server.url, b"x" * 7_000_000), 413, "TooLarge")


def test_other_sites_and_names(server: Serving) -> None:
    for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}):
        answer = httpx.get(f"{server.url}/v1/maps", headers=headers)
        problem(answer, 403, "Forbidden")
    own = {"Origin": server.url}
    assert httpx.get(f"{server.url}/v1/maps", headers=own).status_code == 200


def test_pages_and_numbers(server: Serving, client: Client) -> None:
    def get(path: str) -> Any:
        return httpx.get(f"{server.url}{path}")

    (about,) = client.maps()
    assert about["name"] == "room"
    assert about["references"] == 1
    assert get("/health").json()["workers"] == 2
    text = get("/metrics").text
    assert "gscpe_workers_ready 2" in text
    assert "gscpe_requests_total{" in text
    assert "choose a photo" in get("/").text.lower()
    assert get("/").headers["content-security-policy"].startswith("default-src 'none'")
    docs = get("/docs").text
    assert "/v1/maps/{map_name}/localize" in docs
    assert "https://" not in docs
    api = get("/openapi.json").json()
    assert "/v1/maps/{map_name}/localize" in api["paths"]
    for answer in (get("/"), get("/v1/maps"), get("/nothing")):
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "server" not in answer.headers


def test_renders_and_the_view_from_above(server: Serving, client: Client, room: RoomFolder) -> None:
    answer = client.localize("room", photo_of(room), CAMERA)
    query = {"camera": CAMERA.colmap_text(), "cam_from_world": answer["cam_from_world"]}
    picture = httpx.get(f"{server.url}/v1/maps/room/render", params=query, timeout=60)
    assert picture.headers["content-type"] == "image/jpeg"
    render, photo = decode_image(picture.content, "a"), decode_image(photo_of(room), "b")
    assert render.shape == photo.shape
    assert np.median(np.abs(render.astype(float) - photo)) < 12
    huge = query | {"camera": CAMERA.resized(50_000, 37_500).colmap_text()}
    shrunk = httpx.get(f"{server.url}/v1/maps/room/render", params=huge, timeout=60)
    assert decode_image(shrunk.content, "c").shape[:2] == (960, 1280)
    above = httpx.get(f"{server.url}/v1/maps/room/above", timeout=60).json()
    assert above["drawing"].startswith("<svg")
    matrix = np.array(answer["matrix"])
    centre = np.append(-matrix[:3, :3].T @ matrix[:3, 3], 1.0)
    x, y = np.array(above["pixel_from_world"]) @ centre
    assert 0 < x < above["width"]
    assert 0 < y < above["height"]


def test_a_token(fake: Callable[..., Service]) -> None:
    with serving(fake(token=TOKEN)) as guarded:
        url = guarded.url
        for headers in ({}, {"Authorization": "Bearer wrong"}):
            answer = httpx.get(f"{url}/v1/maps", headers=headers)
            problem(answer, 401, "Unauthorized")
            assert answer.headers["www-authenticate"].startswith("Bearer")
        problem(httpx.get(f"{url}/metrics"), 401, "Unauthorized")
        assert httpx.get(f"{url}/").status_code == httpx.get(f"{url}/health").status_code == 200
        with Client(url, TOKEN) as client:
            assert client.localize("room", b"echo hello")["text"] == "hello"
        with Client(url, "wrong token") as client, pytest.raises(ServiceError, match="Bearer"):
            client.maps()


def test_a_full_queue(fake: Callable[..., Service], tmp_path: Path) -> None:
    flag = tmp_path / "flag"
    with serving(fake(limits=Limits(queue=2))) as small, ThreadPoolExecutor(2) as pool:
        url, says = small.url, f"wait {flag}".encode()
        inside = [pool.submit(post, url, says) for _ in range(2)]
        wait_until(lambda: small.service.gate.inside == 2)
        answer = post(url, b"echo no")
        assert "2 at a time" in problem(answer, 503, "Busy")
        assert int(answer.headers["retry-after"]) >= 1
        flag.touch()
        assert [each.result().status_code for each in inside] == [200, 200]
        with Client(url) as client:
            assert client.localize("room", b"echo yes")["text"] == "yes"


def test_a_client_that_leaves_frees_its_worker(
    fake: Callable[..., Service], tmp_path: Path
) -> None:
    with serving(fake()) as one:
        address, files = f"{one.url}/v1/maps/room/localize", {"photo": f"wait {tmp_path / 'f'}"}
        with pytest.raises(httpx.ReadTimeout):
            httpx.post(address, files=files, timeout=httpx.Timeout(60, read=1.0))
        wait_until((tmp_path / "f.stopped").exists)
        assert post(one.url, b"echo on").json()["text"] == "on"
        assert one.service.metrics.replaced == 0
        wait_until(lambda: one.service.gate.inside == 0)


def test_a_worker_that_is_killed_at_work(server: Serving, room: RoomFolder) -> None:
    """Its photo is answered all the same."""
    before = server.service.staff.pids()
    with ThreadPoolExecutor(12) as pool:
        answers = [pool.submit(post, server.url, photo_of(room)) for _ in range(12)]
        busy = wait_until(lambda: [p for p, name in server.service.staff.pids().items() if name])
        os.kill(busy[0], signal.SIGKILL)
        statuses = [answer.result().json()["status"] for answer in answers]
    assert statuses == ["localized"] * 12
    wait_until(lambda: server.service.staff.alive == 2)
    assert set(server.service.staff.pids()) != set(before)


def test_mutated_requests(server: Serving, room: RoomFolder, rng: np.random.Generator) -> None:
    """None crashes it (tools/bench_serve.py sends 500)."""
    photo = photo_of(room)
    request = httpx.Request(
        "POST", f"{server.url}/v1/maps/room/localize", files={"photo": ("a.png", photo)},
        data={"camera": CAMERA.colmap_text(), "prior": "1 0 0 0 0 0 0"},
    )  # fmt: skip
    body, kind = bytearray(request.read()), request.headers["content-type"]
    with httpx.Client(timeout=120) as client:
        for _ in range(25):
            mutated = bytearray(body)
            where = 500 if rng.random() < 0.7 else len(mutated)
            for at in rng.integers(0, where, rng.integers(1, 30)):
                mutated[at] = rng.integers(0, 256)
            answer = client.post(
                str(request.url), content=bytes(mutated), headers={"content-type": kind}
            )
            assert answer.status_code < 500
    assert server.service.health()[0]


def test_sigterm_finishes_what_is_running(room: RoomFolder, tmp_path: Path) -> None:
    arguments = ["serve", str(room.path / "room.gsmap"), "--port", "0", "--workers", "1"]
    command = subprocess.Popen(
        [sys.executable, "-m", "gscpe", *arguments, "--matcher", "sift"],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert command.stderr is not None
    line = command.stderr.readline()
    while not line.startswith("gscpe serve: http"):
        assert line, "it ended"
        line = command.stderr.readline()
    url = line.split()[2].rstrip(",")
    answers: list[Any] = []
    threads = [
        threading.Thread(target=lambda: answers.append(post(url, photo_of(room)))) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    wait_until(lambda: httpx.get(f"{url}/health").json()["waiting"] >= 2)
    command.send_signal(signal.SIGTERM)
    for thread in threads:
        thread.join()
    assert [answer.json()["status"] for answer in answers] == ["localized"] * 4
    assert command.wait(60) == 0
    assert command.stderr.read().strip() == "gscpe serve: ended"


def test_what_the_command_line_refuses(
    room: RoomFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    map_ = str(room.path / "room.gsmap")

    def refused(*arguments: str) -> str:
        assert main(["serve", *arguments]) == 2
        return capsys.readouterr().err

    assert "--token-file" in refused(map_, "--host", "0.0.0.0")
    assert "cannot be read" in refused(map_, "--token-file", str(tmp_path / "no"))
    assert "is given twice" in refused(map_, map_)
    odd = tmp_path / "it's @ home.gsmap"
    shutil.copytree(map_, odd)
    assert "that an address cannot have" in refused(str(odd))
    assert "it has no map.json" in refused(str(tmp_path))
    assert "together" in refused(map_, "--key", "k.pem")
    assert "cannot listen" in refused(map_, "--host", "203.0.113.1", "--insecure")


def test_typed_errors_of_the_client(client: Client, room: RoomFolder, tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match="is not an image"):
        client.localize("room", b"nothing")
    with pytest.raises(CameraError, match="of the form"):
        client.localize("room", photo_of(room), "PINHOLE")
    with pytest.raises(ServiceError, match="no map of this name"):
        client.localize("garden", photo_of(room))
    with pytest.raises(PhotoError, match="cannot be read"):
        client.localize("room", tmp_path / "missing.jpg")
    with Client("http://127.0.0.1:9") as nobody, pytest.raises(ServiceError, match="be reached"):
        nobody.maps()


def test_a_map_that_was_built_anew_is_refused(room: RoomFolder) -> None:
    from gscpe.batch.shelf import Shelf

    order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
    changed = replace(order, fingerprints={"room": "0" * 12})
    with Shelf(changed) as shelf, pytest.raises(MapError, match="has changed since"):
        shelf.localizer("room")


def test_a_shelf_makes_room(room: RoomFolder, tmp_path: Path) -> None:
    import shutil

    from gscpe.batch.shelf import Shelf, map_bytes

    folders = []
    for name in "abc":
        folders.append(str(tmp_path / f"{name}.gsmap"))
        shutil.copytree(room.path / "room.gsmap", folders[-1])
    size = map_bytes(Path(folders[0]))
    order = shelf_order(folders, matcher="sift", memory=int(2.5 * size))
    with Shelf(order) as shelf:
        first = shelf.localizer("a")
        shelf.localizer("b")
        assert shelf.localizer("a") is first
        shelf.localizer("c")
        assert shelf.held == ("a", "c")
    with Shelf(replace(order, memory=1)) as shelf:
        shelf.localizer("a")
        shelf.localizer("b")
        assert shelf.held == ("b",)
