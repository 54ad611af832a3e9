# SPDX-License-Identifier: Apache-2.0
"""HTML pages that are one file: nothing is loaded, and nothing runs but what they bring along."""

from __future__ import annotations

import base64
import hashlib
from typing import Any, Mapping

from markupsafe import Markup


def filled_page(template: str, values: Mapping[str, Any], style: str, script: str = "") -> str:
    """A Jinja2 template filled in. It is also given ``style``, ``script``, and ``policy``: a
    Content Security Policy that allows these two and pictures within the page.

    Args:
        template: HTML; what is put in is escaped.
        values: by name; a name that the template needs and that is missing is an error.
        style: CSS.
        script: JavaScript; none if it is empty.
    """
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    filled = environment.from_string(template).render(
        values, style=Markup(style), script=Markup(script), policy=_policy(style, script)
    )
    return filled.lstrip()


def _policy(style: str, script: str) -> str:
    scripts = f"script-src '{_digest(script)}'; " if script else ""
    return (
        f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; {scripts}"
        "base-uri 'none'; form-action 'none'"
    )


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
