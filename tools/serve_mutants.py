# SPDX-License-Identifier: Apache-2.0
"""Requests that are spoilt, for tools/bench_serve.py: random bytes, cut off, mixed up, nonsense."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Callable, ClassVar, Mapping

import numpy as np

from gscpe import Camera

if TYPE_CHECKING:
    import httpx

KINDS = ("pixels", "photo's header", "form", "cut off", "pieces exchanged", "texts")
"""What is spoilt; requests take turns."""

_HEADERS = {"content-type": "multipart/form-data; boundary=0123456789abcdef"}
"""httpx would draw a boundary at random."""

_PROBLEM = "application/problem+json"

_TEXTS: tuple[Mapping[str, str], ...] = (
    {"camera": "PINHOLE,640,480,nan,nan,320,240"},
    {"camera": "PINHOLE,640,480,1e308,1e-308,320,240"},
    {"camera": '{"model": "PINHOLE", "width": NaN, "height": 480, "params": [1, 1, 1, 1]}'},
    {"camera": "[" * 4000},
    {"camera": "PINHOLE," + "9" * 3000 + ",480,525,525,320,240"},
    {"prior": "nan nan nan nan 0 0 0"},
    {"prior": "1 0 0 0 1e300 -1e300 1e300"},
    {"prior": "[[1e400, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"},
    {"prior": "1 0 0 0 0 0 0", "prior_sigma": "-1 1e999"},
    {"camera": "\x00", "prior": "\x00"},
    {f"field{i}": "x" for i in range(20)},
)


@dataclass
class Verdict:
    """What requests of one kind were answered with.

    Attributes:
        wrong: answers that none may have.
    """

    names: ClassVar = ("localized", "not localized", "4xx", "503", "wrong")
    counts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, verdict: str) -> None:
        with self.lock:
            if verdict in self.names:
                self.counts[verdict] += 1
            else:
                self.wrong.append(verdict)

    def texts(self) -> list[str]:
        """For a row of a table."""
        return [*(str(self.counts[name]) for name in self.names[:-1]), str(len(self.wrong))]


def verdict_of(answer: httpx.Response) -> str:
    """One of :attr:`Verdict.names`, or what is wrong with the answer."""
    content = answer.json() if "json" in answer.headers.get("content-type", "") else {}
    if answer.status_code == 200 and content.get("status") in ("localized", "not localized"):
        return str(content["status"])
    typed = answer.headers.get("content-type") == _PROBLEM and "error" in content
    if typed and answer.status_code == 503 and "retry-after" in answer.headers:
        return "503"
    if typed and 400 <= answer.status_code < 500:
        return "4xx"
    return f"status {answer.status_code}: {answer.text[:200]}"


def mutants(
    address: str, photo: Path, camera: Camera
) -> Callable[[int], tuple[str, httpx.Request]]:
    """Makes the request of a number, always the same one, and says of which kind it is."""
    import httpx

    data = photo.read_bytes()

    def form(**texts: str) -> httpx.Request:
        files = {"photo": (photo.name, data)}
        return httpx.Request("POST", address, files=files, data=texts, headers=_HEADERS)

    whole = form(camera=camera.colmap_text(), prior="1 0 0 0 0 0 0")
    body = whole.read()

    def mutant(number: int) -> tuple[str, httpx.Request]:
        kind = KINDS[number % len(KINDS)]
        if kind == "texts":
            texts = _TEXTS[number // len(KINDS) % len(_TEXTS)]
            return kind, form(**{"camera": camera.colmap_text(), **texts})
        spoilt = _spoilt(body, kind, np.random.default_rng(number))
        return kind, httpx.Request("POST", address, content=spoilt, headers=_HEADERS)

    return mutant


def _spoilt(body: bytes, kind: str, rng: np.random.Generator) -> bytes:
    if kind == "cut off":
        return body[: rng.integers(0, len(body))]
    if kind == "pieces exchanged":
        a, b, c = sorted(rng.integers(0, len(body), 3))
        return body[:a] + body[b:c] + body[a:b] + body[c:]
    # httpx writes the texts first, then the photo.
    begin = body.index(b"filename=")
    first, end = {
        "pixels": (begin, len(body)),
        "photo's header": (begin, begin + 2000),
        "form": (0, begin + 100),
    }[kind]
    spoilt = bytearray(body)
    for at in rng.integers(first, min(end, len(body)), rng.integers(1, 40)):
        spoilt[at] = rng.integers(0, 256)
    return bytes(spoilt)
