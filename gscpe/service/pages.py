# SPDX-License-Identifier: Apache-2.0
"""Pages that need no network: style and script are inside, and nothing else is allowed."""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Mapping

from markupsafe import Markup

_STYLE, _SCRIPT = "/*STYLE*/", "/*SCRIPT*/"


@dataclass(frozen=True)
class Page:
    """HTML, and the policy under which browsers shall show it."""

    html: str
    policy: str


@cache
def front_page() -> Page:
    """For phones: a photo in, its place out."""
    style, script = _text("page.css"), _text("page.js")
    html = _text("page.html").replace(_STYLE, style).replace(_SCRIPT, script)
    return Page(html, _policy(style, script))


def docs_page(api: Mapping[str, Any]) -> Page:
    """The addresses of a service, written from its OpenAPI description."""
    style = _text("docs.css")
    rows = [
        _operation(method, path, operation)
        for path, methods in api["paths"].items()
        for method, operation in methods.items()
    ]
    info = api["info"]
    html = Markup(
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<title>{title}</title><link rel="icon" href="data:,"><style>{style}</style></head>'
        "<body><h1>{title} {version}</h1><p>{about} For programs: "
        '<a href="openapi.json">openapi.json</a>; by hand: <a href="./">the page</a>.</p>'
        "{rows}{track}</body></html>"
    ).format(
        title=info["title"],
        version=info["version"],
        about=info["description"],
        style=Markup(style),
        rows=Markup("").join(rows),
        track=_TRACK,
    )
    return Page(str(html), _policy(style, None))


_TRACK = Markup(
    "<section><h2><b>WS</b> /v1/maps/{map_name}/track</h2><p>First a text, "
    '<code>{"camera": "PINHOLE,640,480,..."}</code> (with a token: also <code>"token"</code>, '
    "where no header can be sent); then a JPEG in each binary message, if you like after a text "
    '<code>{"time": SECONDS}</code>. Answers are JSON, one for each frame that was not lost, in '
    "their order.</p></section>"
)


def _operation(method: str, path: str, operation: Mapping[str, Any]) -> Markup:
    content = operation.get("requestBody", {}).get("content", {})
    fields = [
        (name, about.get("description", ""))
        for form in content.values()
        for name, about in form["schema"].get("properties", {}).items()
    ]
    fields += [
        (parameter["name"], f"in the {parameter['in']}")
        for parameter in operation.get("parameters", ())
    ]
    items = (
        Markup("<dt><code>{}</code></dt><dd>{}</dd>").format(name, about) for name, about in fields
    )
    return Markup("<section><h2><b>{}</b> {}</h2><p>{}</p><dl>{}</dl></section>").format(
        method.upper(), path, _with_code(operation.get("description", "")), Markup("").join(items)
    )


def _with_code(text: str) -> Markup:
    """What is `between such marks` is code, as in Markdown."""
    pieces = (
        Markup("<code>{}</code>" if number % 2 else "{}").format(piece)
        for number, piece in enumerate(text.split("`"))
    )
    return Markup("").join(pieces)


def _text(name: str) -> str:
    return resources.files("gscpe.service").joinpath(name).read_text(encoding="utf-8")


def _policy(style: str, script: str | None) -> str:
    scripts = "'none'" if script is None else _hash(script)
    return "; ".join(
        (
            "default-src 'none'",
            f"style-src {_hash(style)}",
            f"script-src {scripts}",
            "img-src data: blob:",
            "media-src blob: mediastream:",
            "connect-src 'self'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        )
    )


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"
