# SPDX-License-Identifier: Apache-2.0
"""Whoever means harm gets a typed refusal or a closed connection, and nobody else notices."""

from __future__ import annotations

import socket
import time
from contextlib import ExitStack
from typing import Callable, Iterator, Sequence
from urllib.parse import urlsplit

import pytest
from batch_room import RoomFolder, wait_until
from serving import Serving, photo_of, post, problem, serving

from gscpe.service.limits import Limits
from gscpe.service.service import Service

httpx = pytest.importorskip("httpx")

PHOTO = b'Content-Disposition: form-data; name="photo"; filename="a.jpg"'
CAMERA = b'Content-Disposition: form-data; name="camera"'
MULTIPART = "multipart/form-data; boundary=x"

Part = tuple[bytes, bytes]


def form(parts: Sequence[Part]) -> bytes:
    whole = (b"--x\r\n" + head + b"\r\n\r\n" + body + b"\r\n" for head, body in parts)
    return b"".join(whole) + b"--x--\r\n"


BODIES = {
    "two photos": (form([(PHOTO, b"a"), (PHOTO, b"b")]), MULTIPART),
    "a photo that is no file": (form([(PHOTO.partition(b"; filename")[0], b"a")]), MULTIPART),
    "no name": (form([(b"Content-Disposition: form-data", b"a")]), MULTIPART),
    "no disposition": (form([(b"X: y", b"a")]), MULTIPART),
    "odd file names": (form([(PHOTO.replace(b"a.jpg", b"\0../\xff\xfe/e\r\n"), b"a")]), MULTIPART),
    "letters in no encoding": (form([(CAMERA, b"\xff\xfe\x00"), (PHOTO, b"a")]), MULTIPART),
    "many headers": (form([(PHOTO + b"\r\nX: y" * 10_000, b"a")]), MULTIPART),
    "a long header": (form([(PHOTO + b"\r\nX: " + b"y" * 1_000_000, b"a")]), MULTIPART),
    "many fields": (form([(CAMERA, b"")] * 50_000), MULTIPART),
    "a long text": (form([(CAMERA, b"1" * 1_000_000), (PHOTO, b"a")]), MULTIPART),
    "no boundary": (b"a", "multipart/form-data"),
    "a long boundary": (b"a", "multipart/form-data; boundary=" + "x" * 20_000),
    "an odd charset": (form([(PHOTO, b"a")]), f"{MULTIPART}; charset=nonsense"),
    "never begun": (b"--y\r\n", MULTIPART),
    "never ended": (form([(PHOTO, b"a" * 100)])[:-20], MULTIPART),
    "no form": (b'{"photo": "a"}', "application/json"),
    "another form": (b"photo=a&" * 100_000, "application/x-www-form-urlencoded"),
}


@pytest.mark.parametrize("what", BODIES)
def test_tricks_with_forms(server: Serving, what: str) -> None:
    body, kind = BODIES[what]
    answer = httpx.post(
        f"{server.url}/v1/maps/room/localize", content=body, headers={"Content-Type": kind}
    )
    assert 400 <= answer.status_code < 500
    problem(answer, answer.status_code, answer.json()["error"])
    assert server.service.gate.inside == 0


@pytest.mark.parametrize(
    "name", ["..%2f..%2fetc%2fpasswd", "%2e%2e", "room%00", "ROOM", "room%20", "%ff%fe", "a" * 5000]
)
def test_names_of_maps_are_no_paths(server: Serving, room: RoomFolder, name: str) -> None:
    address = f"{server.url}/v1/maps/{name}/localize"
    problem(httpx.post(address, files={"photo": ("a.png", photo_of(room))}), 404, "NotFound")
    problem(httpx.get(f"{server.url}/v1/maps/{name}/above"), 404, "NotFound")


def connected(server: Serving, stack: ExitStack) -> socket.socket:
    parts = urlsplit(server.url)
    return stack.enter_context(socket.create_connection((parts.hostname, parts.port), 30))


def head_of(length: int) -> bytes:
    return (
        b"POST /v1/maps/room/localize HTTP/1.1\r\nHost: localhost\r\n"
        b"Content-Type: multipart/form-data; boundary=x\r\n"
        b"Content-Length: %d\r\n\r\n" % length
    )


def test_uploads_that_end_in_the_middle(server: Serving, room: RoomFolder) -> None:
    body = form([(PHOTO, photo_of(room))])
    for cut in (0, 10, len(body) // 2, len(body) - 1):
        with ExitStack() as stack:
            connected(server, stack).sendall(head_of(len(body)) + body[:cut])
            wait_until(lambda: server.service.gate.inside == 1)
        wait_until(lambda: server.service.gate.inside == 0)
    assert post(server.url, photo_of(room)).json()["status"] == "localized"


@pytest.fixture
def hasty(fake: Callable[..., Service]) -> Iterator[Serving]:
    """Nobody may be idle for more than a second."""
    limits = Limits(idle_seconds=1.0, upload_seconds=1.0)
    with serving(fake(workers=2, limits=limits)) as server:
        yield server


def read(connection: socket.socket) -> bytes:
    """All that comes before the connection ends."""
    received = b""
    try:
        while data := connection.recv(1_000_000):
            received += data
    except ConnectionResetError:
        pass
    return received


def test_connections_without_requests_are_closed(hasty: Serving) -> None:
    """Also those that send their heads letter by letter."""
    with ExitStack() as stack:
        silent, slow, second = (connected(hasty, stack) for _ in range(3))
        second.sendall(b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert second.recv(1000).startswith(b"HTTP/1.1 200")
        for connection in (slow, second):
            letters = iter(b"GET / HTTP/1.1\r\nX: " + b"y" * 1000)
            with pytest.raises(OSError, match=r"Broken|reset"):
                while True:
                    connection.sendall(bytes([next(letters)]))
                    time.sleep(0.05)
        assert read(silent) == b""


def test_a_body_that_does_not_come(hasty: Serving) -> None:
    with ExitStack() as stack:
        slow = connected(hasty, stack)
        slow.sendall(head_of(1000) + b"--x\r\n")
        assert b"408" in slow.recv(1000)
    wait_until(lambda: hasty.service.gate.inside == 0)


def test_an_answer_that_is_not_taken(hasty: Serving) -> None:
    text = b"echo " + b"y" * 20_000_000
    body = form([(PHOTO, text)])
    with ExitStack() as stack:
        lazy = connected(hasty, stack)
        lazy.sendall(head_of(len(body)) + body)
        wait_until(lambda: "gscpe_requests_total" in httpx.get(f"{hasty.url}/metrics").text)
        time.sleep(4.0)
        assert len(read(lazy)) < len(text)


def test_work_and_busy_clients_may_take_longer(hasty: Serving) -> None:
    assert post(hasty.url, b"toil 2.5").json()["text"] == "done"
    with httpx.Client(limits=httpx.Limits(max_connections=1)) as client:
        for _ in range(6):
            assert client.get(f"{hasty.url}/health").status_code == 200
            time.sleep(0.4)
