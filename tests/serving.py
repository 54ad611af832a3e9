# SPDX-License-Identifier: Apache-2.0
"""Real servers, in a thread of the tests."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Iterator

from gscpe.service.server import listen, make_server
from gscpe.service.service import Service


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
