# SPDX-License-Identifier: Apache-2.0
"""What a server answers to what it cannot use, and to whom it does not serve."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Callable, Iterator

import numpy as np
import pytest
from batch_room import CAMERA, RoomFolder, wait_until
from serving import TOKEN, Serving, photo_of, png_bomb, post, problem, serving

from gscpe import Client, ServiceError
from gscpe.service.limits import Limits
from gscpe.service.service import Service

httpx = pytest.importorskip("httpx")


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


def test_a_camera_has_no_more_pixels_than_a_photo(server: Serving) -> None:
    query = {"cam_from_world": "1 0 0 0 0 0 0", "camera": CAMERA.resized(1001, 1000).colmap_text()}
    answer = httpx.get(f"{server.url}/v1/maps/room/render", params=query)
    detail = problem(answer, 422, "CameraError")
    assert detail == "a camera may have 1000000 pixels here, not 1001x1000"


@pytest.mark.parametrize("path", ["/v1/maps/room/localize", "/v1/localize"])
def test_what_nobody_would_read_is_refused(server: Serving, room: RoomFolder, path: str) -> None:
    photo, text = photo_of(room), CAMERA.colmap_text()

    def asked(query: str = "", **form: str | list[str]) -> str:
        address = f"{server.url}{path}{query}"
        answer = httpx.post(address, files={"photo": ("a.png", photo)}, data=form, timeout=120)
        return problem(answer, 422, "InputError")

    known = "a form has these: photo, camera, prior, prior_sigma"
    assert asked(kamera=text, priors="") == f"unknown form field: kamera, priors; {known}"
    assert asked(camera=[text, text]) == "given more than once: camera"
    assert asked(f"?camera={text}") == f"nothing is read from the address after the ?; {known}"
    misnamed = httpx.post(f"{server.url}{path}", files={"foto": ("a.png", photo)}, timeout=120)
    assert problem(misnamed, 422, "InputError") == f"unknown form field: foto; {known}"


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
