# SPDX-License-Identifier: Apache-2.0
"""A real server of a small map: as the command line answers."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from batch_room import CAMERA, QUERIES, RoomFolder
from serving import Serving, photo_of

from gscpe import CameraError, Client, PhotoError, PoseError, PosePrior, ServiceError
from gscpe.cli.main import main
from gscpe.photos.image_file import decode_image
from gscpe.poses.hloc import parse_pose

httpx = pytest.importorskip("httpx")


def without_times(detail: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in detail.items() if key not in ("seconds", "name")}


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
    assert "<code>gscpe localize --json</code>" in docs
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
    wide = query | {"camera": CAMERA.resized(5000, 200).colmap_text()}
    shrunk = httpx.get(f"{server.url}/v1/maps/room/render", params=wide, timeout=60)
    assert decode_image(shrunk.content, "c").shape[:2] == (51, 1280)
    above = httpx.get(f"{server.url}/v1/maps/room/above", timeout=60).json()
    assert above["drawing"].startswith("<svg")
    matrix = np.array(answer["matrix"])
    centre = np.append(-matrix[:3, :3].T @ matrix[:3, 3], 1.0)
    x, y = np.array(above["pixel_from_world"]) @ centre
    assert 0 < x < above["width"]
    assert 0 < y < above["height"]


def test_typed_errors_of_the_client(client: Client, room: RoomFolder, tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match="is not an image"):
        client.localize("room", b"nothing")
    with pytest.raises(CameraError, match="of the form"):
        client.localize("room", photo_of(room), "PINHOLE")
    for name in ("garden", "room?x=", "../maps/room", "a b"):
        with pytest.raises(ServiceError, match=r"no map of this name|nothing at this address"):
            client.localize(name, photo_of(room))
    with pytest.raises(PhotoError, match="cannot be read"):
        client.localize("room", tmp_path / "missing.jpg")
    with Client("http://127.0.0.1:9") as nobody, pytest.raises(ServiceError, match="be reached"):
        nobody.maps()
