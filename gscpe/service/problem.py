# SPDX-License-Identifier: Apache-2.0
"""Errors as problem JSON (RFC 9457): those that a caller can act upon in the words of the command
line, all others without any detail: no path, no stack trace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gscpe.errors import CameraError, InputError, PhotoError, PoseError

MEDIA_TYPE = "application/problem+json"

_DOCS = "https://github.com/gscpe/gscpe/blob/main/docs/serving.md#errors"

_TITLES = {
    "PhotoError": "The photo cannot be used",
    "CameraError": "The camera cannot be used",
    "PoseError": "The pose cannot be used",
    "InputError": "The request cannot be used",
    "NotFound": "There is no such thing here",
    "TooLarge": "The request is too large",
    "TooSlow": "The request took too long",
    "Busy": "The service is busy",
    "Unauthorized": "A token is needed",
    "Forbidden": "The request is not allowed",
    "WorkerError": "The workers failed",
    "Failed": "The service failed",
}


@dataclass(frozen=True)
class Problem:
    """What went wrong.

    Attributes:
        status: of HTTP.
        error: a word for programs; a class of gscpe.errors where there is one.
        detail: for people; it holds nothing of the server's own.
        retry_after: seconds after which it may be tried again, or None.
    """

    status: int
    error: str
    detail: str
    retry_after: int | None = None

    def as_json(self) -> dict[str, Any]:
        """The members of RFC 9457, and ``error``."""
        return {
            "type": _DOCS,
            "title": _TITLES.get(self.error, "The request cannot be used"),
            "status": self.status,
            "detail": self.detail,
            "error": self.error,
        }

    def headers(self) -> dict[str, str]:
        """Beside the answer."""
        headers = {}
        if self.retry_after is not None:
            headers["Retry-After"] = str(self.retry_after)
        if self.status == 401:
            headers["WWW-Authenticate"] = 'Bearer realm="gscpe"'
        return headers


class ProblemError(Exception):
    """Ends a request with a problem."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)  # so that it can be pickled
        self.problem = problem


def problem_of(error: Exception) -> Problem:
    """The problem that an error is to whoever sent the request."""
    if isinstance(error, ProblemError):
        return error.problem
    if isinstance(error, PhotoError | CameraError | PoseError):
        return Problem(422, type(error).__name__, one_line(str(error)))
    if type(error) is InputError:
        return Problem(422, "InputError", one_line(str(error)))
    return failed()


def failed() -> Problem:
    """What is the server's own business."""
    return Problem(500, "Failed", "the service could not do this; its log says why")


def too_large(detail: str) -> Problem:
    return Problem(413, "TooLarge", detail)


def too_slow(detail: str, status: int = 408) -> Problem:
    return Problem(status, "TooSlow", detail)


def busy(detail: str, retry_after: int) -> Problem:
    return Problem(503, "Busy", detail, max(1, retry_after))


def not_waited_for() -> Problem:
    """Whoever asked has left: nobody reads this, and it counts as no failure of the service."""
    return Problem(499, "Gone", "nobody waits for the answer")


def not_found(detail: str) -> Problem:
    return Problem(404, "NotFound", detail)


def one_line(text: str, most: int = 500) -> str:
    """Printable, on one line, and not too long."""
    words = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return words if len(words) <= most else words[: most - 3] + "..."
