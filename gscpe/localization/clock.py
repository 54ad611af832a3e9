# SPDX-License-Identifier: Apache-2.0
"""Wall time by stage."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import Iterator


class Clock:
    """Adds up the seconds that each stage takes."""

    def __init__(self) -> None:
        self._begin = time.perf_counter()
        self._stages: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Counts what runs inside as this stage."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self._stages[name] = self._stages.get(name, 0.0) + time.perf_counter() - begin

    def seconds(self) -> dict[str, float]:
        """Seconds by stage, and in all under ``"total"``."""
        return {**self._stages, "total": time.perf_counter() - self._begin}
