# SPDX-License-Identifier: Apache-2.0
"""What a service counts, as Prometheus reads it (text format 0.0.4)."""

from __future__ import annotations

import threading
from collections import Counter
from typing import Mapping

_BUCKETS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)


class Metrics:
    """Threads may share it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._requests: Counter[tuple[str, int]] = Counter()
        self._photos: Counter[tuple[str, str]] = Counter()
        self._frames: Counter[tuple[str, str]] = Counter()
        self._seconds: Counter[float] = Counter()
        self._sum = 0.0
        self._count = 0
        self.replaced = 0

    def request(self, route: str, status: int) -> None:
        """One was answered."""
        with self._lock:
            self._requests[route, status] += 1

    def photo(self, map_: str, status: str, seconds: float) -> None:
        """One was localized, or not, so long after its request came."""
        with self._lock:
            self._photos[map_, status] += 1
            self._sum += seconds
            self._count += 1
            for bound in _BUCKETS:
                self._seconds[bound] += seconds <= bound

    def frame(self, map_: str, status: str) -> None:
        """One of a camera that is followed."""
        with self._lock:
            self._frames[map_, status] += 1

    def mean_seconds(self) -> float:
        """From a photo's request to its answer, one second before there was any."""
        with self._lock:
            return self._sum / self._count if self._count else 1.0

    def text(self, gauges: Mapping[str, tuple[str, float]]) -> str:
        """All of it.

        Args:
            gauges: what is true just now, by name: what it is, and its value.
        """
        with self._lock:
            lines = [
                *_head("gscpe_requests_total", "counter", "Requests that were answered."),
                *(
                    _line("gscpe_requests_total", number, route=route, status=status)
                    for (route, status), number in sorted(self._requests.items())
                ),
                *_head("gscpe_photos_total", "counter", "Photos that were answered."),
                *(
                    _line("gscpe_photos_total", number, map=map_, status=status)
                    for (map_, status), number in sorted(self._photos.items())
                ),
                *_head("gscpe_frames_total", "counter", "Frames of cameras that are followed."),
                *(
                    _line("gscpe_frames_total", number, map=map_, status=status)
                    for (map_, status), number in sorted(self._frames.items())
                ),
                *_head("gscpe_photo_seconds", "histogram", "From a photo's request to its answer."),
                *(
                    _line("gscpe_photo_seconds_bucket", self._seconds[bound], le=f"{bound:g}")
                    for bound in _BUCKETS
                ),
                _line("gscpe_photo_seconds_bucket", self._count, le="+Inf"),
                _line("gscpe_photo_seconds_sum", self._sum),
                _line("gscpe_photo_seconds_count", self._count),
                *_head("gscpe_workers_replaced_total", "counter", "Workers that died or hung."),
                _line("gscpe_workers_replaced_total", self.replaced),
            ]
        for name, (what, value) in gauges.items():
            lines += [*_head(name, "gauge", what), _line(name, value)]
        return "\n".join(lines) + "\n"


def _head(name: str, kind: str, what: str) -> tuple[str, str]:
    return f"# HELP {name} {what}", f"# TYPE {name} {kind}"


def _line(name: str, value: float, **labels: object) -> str:
    inside = ",".join(f'{label}="{_escaped(str(text))}"' for label, text in labels.items())
    number = f"{value:.6f}" if isinstance(value, float) else str(value)
    return f"{name}{{{inside}}} {number}" if inside else f"{name} {number}"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
