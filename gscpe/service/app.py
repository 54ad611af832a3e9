# SPDX-License-Identifier: Apache-2.0
"""The addresses of a service (FastAPI)."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from typing import Any

from fastapi import FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from gscpe import __version__
from gscpe.errors import CameraError, GscpeError, InputError, PhotoError, PoseError
from gscpe.service import forms
from gscpe.service.desk import LocalizeJob, RenderJob
from gscpe.service.guard import App, Guard
from gscpe.service.limits import Limits, check_camera, check_photo
from gscpe.service.pages import docs_page, front_page
from gscpe.service.problem import (
    MEDIA_TYPE,
    Problem,
    ProblemError,
    failed,
    not_found,
    not_waited_for,
    one_line,
    problem_of,
    too_slow,
)
from gscpe.service.service import Service
from gscpe.service.track import follow

_RENDER_SIDE = 1280

_FIELDS = ("photo", "camera", "prior", "prior_sigma")

_FORM = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["photo"],
                    "additionalProperties": False,
                    "properties": {
                        "photo": {
                            "type": "string",
                            "format": "binary",
                            "description": "JPEG, PNG, WebP or HEIC",
                        },
                        "camera": {
                            "type": "string",
                            "description": "MODEL,width,height,params... as COLMAP, or JSON; "
                            "without it, the focal length is estimated",
                        },
                        "prior": {
                            "type": "string",
                            "description": "qw qx qy qz tx ty tz, or a 4x4 matrix as JSON; world "
                            "to camera",
                        },
                        "prior_sigma": {
                            "type": "string",
                            "description": "LENGTH DEGREES, standard deviations",
                        },
                    },
                }
            }
        },
    }
}


def make_app(service: Service) -> App:
    """The whole application, guarded."""
    app = FastAPI(
        title="gscpe",
        version=__version__,
        description="Where photos were taken, inside 3D Gaussian splats.",
        docs_url=None,
        redoc_url=None,
    )
    _add_maps(app, service)
    _add_pages(app, service)
    _add_problems(app)
    settings = service.settings
    return Guard(
        app, settings.host, settings.token, settings.insecure, service.limits, service.metrics
    )


def _add_maps(app: FastAPI, service: Service) -> None:
    @app.get("/v1/maps")
    async def maps() -> list[dict[str, Any]]:
        """The maps: name, Gaussians, reference photos."""
        return list(service.maps.values())

    @app.post("/v1/maps/{map_name}/localize", openapi_extra=_FORM)
    async def localize(map_name: str, request: Request) -> dict[str, Any]:
        """Where a photo was taken: what `gscpe localize --json` prints. A photo that is not
        localized has status 200, and a reason."""
        service.check_map(map_name)
        begin = time.monotonic()
        with service.gate.passed():
            job = await _job(map_name, request, service.limits)
            answer: dict[str, Any] = await service.answer(job, _gone(request))
        service.photo_done(map_name, answer, begin)
        return answer

    @app.post("/v1/localize", openapi_extra=_FORM)
    async def localize_anywhere(request: Request) -> dict[str, Any]:
        """The same, looked for in all maps: in the most similar ones, until it is found;
        `map_name` says where. A prior cannot be given."""
        begin = time.monotonic()
        with service.gate.passed():
            job = await _job("", request, service.limits)
            if job.prior is not None:
                raise PoseError("a prior belongs to one map: ask that map")
            answer: dict[str, Any] = await service.answer(job, _gone(request))
        service.photo_done(str(answer["map_name"]), answer, begin)
        return answer

    @app.get("/v1/maps/{map_name}/render", response_class=Response)
    async def render(map_name: str, camera: str, cam_from_world: str, request: Request) -> Response:
        """The map as a camera sees it, a JPEG of at most 1280 pixels a side."""
        service.check_map(map_name)
        parsed, pose = forms.parse_camera(camera), forms.parse_cam_from_world(cam_from_world)
        if parsed is None:
            raise CameraError("a render needs a camera")
        check_camera(parsed, service.limits)
        shrink = _RENDER_SIDE / max(parsed.width, parsed.height)
        if shrink < 1:
            size = (max(1, round(shrink * side)) for side in (parsed.width, parsed.height))
            parsed = parsed.resized(*size)
        with service.gate.passed():
            picture = await service.answer(RenderJob(map_name, parsed, pose), _gone(request))
        return Response(picture, media_type="image/jpeg")

    @app.get("/v1/maps/{map_name}/above")
    async def above(map_name: str, request: Request) -> dict[str, Any]:
        """The map from above: `drawing`, the text of an SVG; `width` and `height` of its view box;
        `pixel_from_world`, 2x4, from homogeneous points to its pixels; `metres_per_unit`;
        `caption`."""
        service.check_map(map_name)
        with service.gate.passed():
            return await service.above(map_name, _gone(request))

    @app.websocket("/v1/maps/{map_name}/track")
    async def track(socket: WebSocket, map_name: str) -> None:
        await follow(service, socket, map_name)


def _add_pages(app: FastAPI, service: Service) -> None:
    @app.get("/health")
    async def health() -> JSONResponse:
        """Whether there are workers: 200, or 503."""
        well, numbers = service.health()
        return JSONResponse(numbers, 200 if well else 503)

    @app.get("/metrics", response_class=PlainTextResponse)
    async def metrics() -> PlainTextResponse:
        """What Prometheus reads."""
        return PlainTextResponse(service.metrics_text(), media_type="text/plain; version=0.0.4")

    @app.get("/", include_in_schema=False)
    async def front() -> HTMLResponse:
        page = front_page()
        return HTMLResponse(page.html, headers={"Content-Security-Policy": page.policy})

    @app.get("/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        page = docs_page(app.openapi())
        return HTMLResponse(page.html, headers={"Content-Security-Policy": page.policy})


def _add_problems(app: FastAPI) -> None:
    def answer(problem: Problem) -> JSONResponse:
        return JSONResponse(
            problem.as_json(), problem.status, problem.headers(), media_type=MEDIA_TYPE
        )

    @app.exception_handler(ProblemError)
    @app.exception_handler(GscpeError)
    async def known(_: Request, error: Exception) -> JSONResponse:
        return answer(problem_of(error))

    @app.exception_handler(HTTPException)
    async def of_the_framework(_: Request, error: HTTPException) -> JSONResponse:
        if error.status_code == 404:
            return answer(not_found("there is nothing at this address; see /docs"))
        return answer(Problem(error.status_code, "InputError", one_line(str(error.detail))))

    @app.exception_handler(RequestValidationError)
    async def invalid(_: Request, error: RequestValidationError) -> JSONResponse:
        wrong = "; ".join(f"{each['loc'][-1]}: {each['msg']}" for each in error.errors())
        return answer(Problem(422, "InputError", one_line(wrong)))

    @app.exception_handler(Exception)
    async def unknown(_: Request, error: Exception) -> JSONResponse:
        return answer(failed())


async def _job(map_name: str, request: Request, limits: Limits) -> LocalizeJob:
    """What a form asks for."""
    try:
        async with asyncio.timeout(limits.upload_seconds):
            form = await request.form(max_files=1, max_fields=8, max_part_size=16_384)
    except TimeoutError:
        raise ProblemError(
            too_slow(f"the photo did not arrive within {limits.upload_seconds:g} s")
        ) from None
    except ClientDisconnect:
        raise ProblemError(not_waited_for()) from None
    try:
        _check_fields(form, request)
        return await _job_of(form, map_name, limits)
    finally:
        await form.close()


def _check_fields(form: FormData, request: Request) -> None:
    """A misspelt camera or prior would otherwise change the answer without a word.

    Raises:
        InputError: the form has a field that nobody reads, or one twice; or something stands in
            the address that belongs into the form.
    """
    known = f"a form has these: {', '.join(_FIELDS)}"
    names = [name for name, _ in form.multi_items()]
    if unknown := [name for name in dict.fromkeys(names) if name not in _FIELDS]:
        listed = ", ".join(one_line(name, 60) or "one without a name" for name in unknown)
        raise InputError(f"unknown form field: {listed}; {known}")
    if twice := [name for name in _FIELDS if names.count(name) > 1]:
        raise InputError(f"given more than once: {', '.join(twice)}")
    if request.query_params:
        raise InputError(f"nothing is read from the address after the ?; {known}")


async def _job_of(form: FormData, map_name: str, limits: Limits) -> LocalizeJob:
    photo = form.get("photo")
    if not isinstance(photo, UploadFile):
        raise PhotoError("the form has no file named photo")
    camera, prior, sigma = (_text(form.get(key)) for key in ("camera", "prior", "prior_sigma"))
    name, data = forms.photo_name(photo.filename), await photo.read()
    parsed = forms.parse_camera(camera), forms.parse_prior(prior, sigma)
    await asyncio.to_thread(check_photo, data, name, limits)
    return LocalizeJob(map_name, data, name, *parsed)


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


async def _gone(request: Request) -> None:
    """Ends when whoever sent a request has left."""
    with suppress(ProblemError):
        while (await request.receive())["type"] != "http.disconnect":
            pass
