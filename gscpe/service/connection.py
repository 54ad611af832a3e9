# SPDX-License-Identifier: Apache-2.0
"""Connections that send no request, or take no answer, do not stay for ever."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol


class Connection(H11Protocol):
    """HTTP/1.1 as uvicorn speaks it through h11. uvicorn's ``timeout_keep_alive`` holds for the
    first request as well, and for one whose head arrives letter by letter; and an answer that is
    not taken ends the connection after as long a time."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._since = self.loop.time()
        self._unread: Any = None
        self.loop.call_later(self.timeout_keep_alive, self._look)

    def on_response_complete(self) -> None:
        self._since = self.loop.time()
        super().on_response_complete()

    def _look(self) -> None:
        """Now and then."""
        if self.transport.is_closing() or self.transport.get_protocol() is not self:
            return  # closed, or a WebSocket now
        cycle = self.cycle
        begun = cycle is not None and cycle.response_started
        wait = float(self.timeout_keep_alive)
        if cycle is None or cycle.response_complete:
            wait = self._since + wait - self.loop.time()
            if wait <= 0:
                self.transport.close()
                return
        elif begun and self._unread is cycle:
            self.transport.abort()
            return
        self._unread = cycle if begun else None
        self.loop.call_later(max(wait, 0.01), self._look)
