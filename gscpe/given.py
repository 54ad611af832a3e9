# SPDX-License-Identifier: Apache-2.0
"""Paths and texts as users give them, where Python's own functions raise what no reader expects."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any


def real_path(path: str | Path) -> Path:
    """The absolute path, links followed. Path.resolve raises RuntimeError where a link leads to
    itself; here, whoever opens the path is told so, by an OSError. What links lead to that has no
    path, as ``/dev/stdout`` to a pipe, keeps its own."""
    real = os.path.realpath(path)
    nameless = os.path.exists(path) and not os.path.exists(real)
    return Path(os.path.abspath(path) if nameless else real)


def reading_failed(error: OSError | ValueError) -> str:
    """Why a text file could not be read, without the path, which the message names already."""
    return getattr(error, "strerror", None) or str(error)


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds.

    Raises:
        ValueError: it is no JSON (json.JSONDecodeError, also where it is nested so deeply that
            json.loads would raise RecursionError), or no UTF-8.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise json.JSONDecodeError("nested too deeply", "", 0) from None
