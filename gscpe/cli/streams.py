# SPDX-License-Identifier: Apache-2.0
"""Standard streams as programs get them: closed, missing, or of an encoding without our letters."""

from __future__ import annotations

import io
import logging
import os
import sys
from contextlib import ExitStack, contextmanager
from typing import Iterator, TextIO

import cv2

_NAMES = ("stdout", "stderr")


@contextmanager
def usable_streams() -> Iterator[None]:
    """``sys.stdout`` and ``sys.stderr`` take all that is printed: nothing is shown where there is
    no stream, and a letter that the terminal does not have is shown as its number."""
    with ExitStack() as stack:
        for name in _NAMES:
            stream: TextIO | None = getattr(sys, name)
            if stream is None or stream.closed:
                nowhere = stack.enter_context(open(os.devnull, "w", encoding="utf-8"))
                stack.callback(setattr, sys, name, stream)
                setattr(sys, name, nowhere)
            elif isinstance(stream, io.TextIOWrapper) and stream.errors != "backslashreplace":
                stack.callback(stream.reconfigure, errors=stream.errors)
                stream.reconfigure(errors="backslashreplace")
        yield


@contextmanager
def log_to_stderr(level: int) -> Iterator[None]:
    """gscpe's own messages; those of the libraries below it would only disturb."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    logger = logging.getLogger("gscpe")
    before = logger.handlers, logger.level, logger.propagate
    logger.handlers, logger.propagate = [handler], False
    logger.setLevel(level)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logger.handlers, level, logger.propagate = before
        logger.setLevel(level)


def say(text: str) -> None:
    """Prints a line on standard error, if there is anybody to read it (a terminal that was closed
    is an error)."""
    try:
        print(text, file=sys.stderr, flush=True)
    except OSError:
        return
