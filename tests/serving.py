# SPDX-License-Identifier: Apache-2.0
"""Real servers, in a thread of the tests."""

from __future__ import annotations

import struct
import threading
import time
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Iterator

from batch_room import RoomFolder

from gscpe.service.server import listen, make_server
from gscpe.service.service import Service

TOKEN = "0123456789abcdef0123"


@dataclass(frozen=True)
class Serving:
    """A service and where it listens."""

    service: Service
    url: str


@contextmanager
def serving(service: Service) -> Iterator[Serving]:
    """Serves until the end; closes the service."""
    with listen("127.0.0.1", 0) as socket, service:
        server = make_server(service)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [socket]})
        thread.start()
        try:
            while not server.started:
                assert thread.is_alive()
                time.sleep(0.01)
            yield Serving(service, f"http://127.0.0.1:{socket.getsockname()[1]}")
        finally:
            server.should_exit = True
            thread.join(60)


def photo_of(room: RoomFolder, name: str = "a.png") -> bytes:
    return (room.path / "photos" / name).read_bytes()


def post(url: str, data: bytes, **form: str) -> Any:
    import httpx

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


def png_bomb(width: int, height: int) -> bytes:
    """A PNG of a few bytes that says it is huge."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        crc = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", crc)

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")
