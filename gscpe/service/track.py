# SPDX-License-Identifier: Apache-2.0
"""The WebSocket of a camera that is followed: frames in, poses out."""

from __future__ import annotations

import asyncio
import json
import math
from typing import Any

from fastapi import WebSocket, WebSocketDisconnect

from gscpe.errors import CameraError, GscpeError, InputError
from gscpe.geometry.camera import Camera
from gscpe.service import access, forms
from gscpe.service.following import FrameJob, FrameTimes, LatestFrame, TrackerProcess
from gscpe.service.guard import TOKEN_PENDING, unauthorized
from gscpe.service.limits import Limits, check_camera
from gscpe.service.problem import Problem, ProblemError, problem_of, too_slow
from gscpe.service.service import Service

_FIRST_SECONDS = 10.0
"""That the first message may take."""

_REFUSED, _BUSY, _BROKEN = 1008, 1013, 1011
"""Codes of RFC 6455 and its registry."""


async def follow(service: Service, socket: WebSocket, map_: str) -> None:
    """A connection, to its end."""
    await socket.accept()
    try:
        try:
            service.check_map(map_)
            camera = await _camera(service, socket)
            with service.trackers.passed():
                await _follow(service, socket, map_, camera)
        except (ProblemError, GscpeError) as error:
            problem = problem_of(error)
            await socket.send_json(problem.as_json())
            await socket.close(_BUSY if problem.status == 503 else _REFUSED)
        except ConnectionError as error:
            await socket.send_json(Problem(500, "WorkerError", str(error)).as_json())
            await socket.close(_BROKEN)
    except (WebSocketDisconnect, RuntimeError):  # it has left; RuntimeError: while we answered
        return


async def _camera(service: Service, socket: WebSocket) -> Camera:
    """Of the first message, ``{"camera": ..., "token": ...}``."""
    try:
        async with asyncio.timeout(_FIRST_SECONDS):
            message = await socket.receive()
    except TimeoutError:
        raise ProblemError(too_slow("the first message did not come")) from None
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect
    data = _object(message.get("text"))
    token = service.settings.token
    if (
        token is not None
        and socket.scope.get(TOKEN_PENDING)
        and not access.is_token(str(data.get("token", "")), token)
    ):
        raise ProblemError(unauthorized())
    camera = data.get("camera", "")
    parsed = forms.parse_camera(camera if isinstance(camera, str) else json.dumps(camera))
    if parsed is None:
        raise CameraError("the first message has no camera")
    check_camera(parsed, service.limits)
    return parsed


def _object(text: str | None) -> dict[str, Any]:
    try:
        data = json.loads(text or "")
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise InputError('a text message must be a JSON object: {"camera": ...} or {"time": ...}')
    return data


async def _follow(service: Service, socket: WebSocket, map_: str, camera: Camera) -> None:
    process = TrackerProcess(service.order, map_, camera, service.limits, service.threads)
    latest = LatestFrame()
    try:
        await process.open()
        await socket.send_json({"status": "ready"})
        receiver = asyncio.create_task(_receive(socket, latest))
        try:
            while (frame := await _next_frame(latest, service.limits)) is not None:
                answer = await process.ask(frame)
                service.metrics.frame(map_, answer["status"])
                await socket.send_json(answer | {"frames_lost": latest.lost})
        finally:
            receiver.cancel()
        if not receiver.cancelled() and receiver.done():
            receiver.result()  # what was wrong with a message
    finally:
        await process.end()


async def _next_frame(latest: LatestFrame, limits: Limits) -> FrameJob | None:
    """None at the end. There are few trackers: nobody keeps one without using it."""
    try:
        async with asyncio.timeout(limits.upload_seconds):
            return await latest.take()
    except TimeoutError:
        text = f"no frame came for {limits.upload_seconds:g} s"
        raise ProblemError(too_slow(text)) from None


async def _receive(socket: WebSocket, latest: LatestFrame) -> None:
    """Takes frames until the connection ends."""
    times, number, sent = FrameTimes(), 0, None
    try:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            photo = message.get("bytes")
            if photo is None:
                sent = _seconds(_object(message.get("text")).get("time"))
                continue
            latest.put(FrameJob(number, photo, times.time_of(sent)))
            number, sent = number + 1, None
    finally:
        latest.end()


def _seconds(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError('a time is a number of seconds: {"time": 12.34}')
    return float(value)
