# SPDX-License-Identifier: Apache-2.0
"""Connections that send no request, or take no answer, do not stay for ever."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol


class Connection(H11Protocol):
    """HTTP/1.1 as uvicorn speaks it through h11. uvicorn's ``timeout_keep_alive`` holds for the
    first request as well, and for one whose head arrives letter by letter; and a connection ends
    that takes nothing of an answer for as long a time."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._idle_since = self.loop.time()
        self._unsent = 0
        self.loop.call_later(self.timeout_keep_alive, self._look)

    def on_response_complete(self) -> None:
        self._idle_since = self.loop.time()
        super().on_response_complete()

    def _look(self) -> None:
        """Now and then."""
        if self.transport.get_protocol() is not self:
            return  # it has ended, or is a WebSocket now
        before, self._unsent = self._unsent, self.transport.get_write_buffer_size()
        if self._unsent and self._unsent == before:
            self.transport.abort()  # closing it would wait for the rest to be taken
            return
        wait = float(self.timeout_keep_alive)
        if not self._unsent and (self.cycle is None or self.cycle.response_complete):
            wait = self._idle_since + wait - self.loop.time()
            if wait <= 0:
                self.transport.close()
                return
        self.loop.call_later(max(wait, 0.01), self._look)
