# SPDX-License-Identifier: Apache-2.0
"""What every request passes first: who sends it, how large it is, and what it counts as."""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from typing import Any, Awaitable, Callable, MutableMapping

from gscpe.service import access
from gscpe.service.limits import Limits
from gscpe.service.metrics import Metrics
from gscpe.service.problem import MEDIA_TYPE, Problem, ProblemError, too_large

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

OPEN = {"/", "/health", "/docs", "/openapi.json"}
"""Paths that need no token: they tell nothing about the maps."""

TOKEN_PENDING = "gscpe.token_pending"
"""Set in the scope of a WebSocket whose first message must hold the token: browsers cannot send
headers with one."""

_DRAINED_BODIES = 4
_DRAIN_SECONDS = 5.0
"""How much more than a body may have, and how long, is read of a request that is refused."""

_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cache-control", b"no-store"),
)


class Guard:
    """An ASGI application around another.

    Args:
        app: the other.
        host: that the server listens at.
        token: that requests must bear, or None: the service is for this machine alone, or for
            everybody.
        insecure: it may be reached by any name.
        limits: of a body.
        metrics: that count answers.
    """

    def __init__(
        self,
        app: App,
        host: str,
        token: str | None,
        insecure: bool,
        limits: Limits,
        metrics: Metrics,
    ) -> None:
        self._app, self._host, self._token = app, host, token
        self._insecure, self._limits, self._metrics = insecure, limits, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in _all(scope)}
        problem = self._refusal(scope, headers)
        if scope["type"] == "websocket":
            if problem is None:
                await self._app(scope, receive, send)
            else:
                await receive()
                await send({"type": "websocket.close", "code": 1008, "reason": problem.error})
            return

        async def counted(message: Message) -> None:
            if message["type"] == "http.response.start":
                route = getattr(scope.get("route"), "path", "other")
                self._metrics.request(str(route), int(message["status"]))
                message["headers"] = [*message.get("headers", ()), *_HEADERS]
            await send(message)

        if problem is not None:
            await self._drain(receive)
            await answer_problem(problem, counted)
            return
        await self._app(scope, self._limited(receive), counted)

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> Problem | None:
        host = headers.get("host", "")
        if self._token is None and not self._insecure and not access.is_own_host(host, self._host):
            return Problem(403, "Forbidden", "this service answers to localhost alone")
        if not access.is_own_page(headers.get("origin"), host):
            return Problem(403, "Forbidden", "a page of another site may not use this service")
        if scope["type"] == "http" and self._is_too_large(headers):
            return _too_large(self._limits)
        if self._token is None or scope["path"] in OPEN:
            return None
        return self._without_token(scope, headers.get("authorization"), self._token)

    def _without_token(self, scope: Scope, given: str | None, token: str) -> Problem | None:
        if access.bears(given, token):
            return None
        if scope["type"] == "websocket" and given is None:
            scope[TOKEN_PENDING] = True
            return None
        return unauthorized()

    def _is_too_large(self, headers: dict[str, str]) -> bool:
        length = headers.get("content-length", "0")
        return length.isdecimal() and int(length[:20]) > self._limits.body_bytes

    async def _drain(self, receive: Receive) -> None:
        """Reads on for a while: where a connection is closed with a body underway, its sender sees
        a broken connection, not the answer."""
        left = _DRAINED_BODIES * self._limits.body_bytes
        with suppress(TimeoutError):
            async with asyncio.timeout(_DRAIN_SECONDS):
                while left > 0:
                    message = await receive()
                    if message["type"] != "http.request" or not message.get("more_body"):
                        return
                    left -= len(message.get("body", b""))

    def _limited(self, receive: Receive) -> Receive:
        received = 0

        async def limited() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > self._limits.body_bytes:
                raise ProblemError(_too_large(self._limits))
            return message

        return limited


def unauthorized() -> Problem:
    return Problem(401, "Unauthorized", "send the header: Authorization: Bearer TOKEN")


def _too_large(limits: Limits) -> Problem:
    return too_large(f"a request may have {limits.body_bytes} bytes; shrink the photo")


def _all(scope: Scope) -> list[tuple[bytes, bytes]]:
    return list(scope["headers"])


async def answer_problem(problem: Problem, send: Send) -> None:
    """Sends a problem."""
    body = json.dumps(problem.as_json()).encode()
    headers = {"content-type": MEDIA_TYPE, "content-length": str(len(body)), "connection": "close"}
    headers |= problem.headers()
    await send(
        {
            "type": "http.response.start",
            "status": problem.status,
            "headers": [
                (name.lower().encode("latin-1"), value.encode("latin-1"))
                for name, value in headers.items()
            ],
        }
    )
    await send({"type": "http.response.body", "body": body})
