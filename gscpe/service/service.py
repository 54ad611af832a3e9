# SPDX-License-Identifier: Apache-2.0
"""What the server does, apart from HTTP: its maps, its staff, who may come in."""

from __future__ import annotations

import asyncio
import functools
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import Any, Awaitable, Mapping

from gscpe.batch.choose import check_workers, workers_for
from gscpe.batch.in_process import Start
from gscpe.batch.shelf import ShelfOrder, shelf_bytes
from gscpe.closing import Closing
from gscpe.cores import available_cores
from gscpe.errors import MapError
from gscpe.ranges import check_kinds, check_whole
from gscpe.service.desk import AboveJob, Desk, Job
from gscpe.service.gate import Gate
from gscpe.service.limits import Limits
from gscpe.service.metrics import Metrics
from gscpe.service.problem import Problem, ProblemError, not_found, not_waited_for
from gscpe.service.staff import Staff


@dataclass(frozen=True)
class ServiceSettings:
    """Of a service.

    Attributes:
        host: that it listens at.
        token: that requests must bear, or None.
        insecure: anybody who can reach it may use it.
        workers: processes.
        limits: of requests.

    Raises:
        SettingsError: there are to be no workers.
    """

    host: str = "127.0.0.1"
    token: str | None = None
    insecure: bool = False
    workers: int = 1
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        check_kinds(self, host=str, token=(str, NoneType), insecure=bool, limits=Limits)
        check_whole(self, "workers", least=1)


class Service(Closing):
    """Starts the workers.

    Args:
        order: what they open.
        settings: of the service.
        start: what they hold; None: a :class:`gscpe.service.desk.Desk`.

    Raises:
        SettingsError: there are to be far more workers than the cores can serve.
        WorkerError: they die when they start.
        MapError: a map has a name with letters that an address cannot have.
        GscpeError: what opening the first map raised.
    """

    def __init__(
        self, order: ShelfOrder, settings: ServiceSettings, start: Start | None = None
    ) -> None:
        _check_names(order)
        check_workers(settings.workers)
        self.order, self.settings, self.limits = order, settings, settings.limits
        self.maps = {name: _about(name, folder) for name, folder in order.folders.items()}
        self.threads = max(1, available_cores() // settings.workers)
        self.metrics = Metrics()
        start = start or functools.partial(Desk.start, order, self.threads)
        self.staff = Staff(start, settings.workers, self.threads, self.limits, self.metrics)
        self.gate = Gate(self.limits.queue, "too many requests wait", self._queue_seconds)
        self.trackers = Gate(self.limits.trackers, "all trackers are in use", lambda: 30.0)
        self._above: dict[str, dict[str, Any]] = {}

    def _queue_seconds(self) -> float:
        inside = self.gate.inside
        return inside / max(1, self.settings.workers) * min(2.0, self.metrics.mean_seconds())

    def check_map(self, name: str) -> None:
        """Raises ProblemError where there is no such map."""
        if name not in self.maps:
            known = ", ".join(self.maps)
            raise ProblemError(not_found(f"there is no map of this name; there are: {known}"))

    async def answer(self, job: Job, gone: Awaitable[None]) -> Any:
        """What the staff says to a job.

        Args:
            job: for it.
            gone: ends when nobody waits for the answer any more; the job is called off then.

        Raises:
            ProblemError: the answer is a problem, or nobody waits.
        """
        ticket = self.staff.submit(job)
        answered = asyncio.wrap_future(ticket.future)
        left = asyncio.ensure_future(gone)
        try:
            await asyncio.wait({answered, left}, return_when=asyncio.FIRST_COMPLETED)
            if not answered.done():
                raise ProblemError(not_waited_for())
            answer = answered.result()
        finally:
            left.cancel()
            if not ticket.future.done():
                self.staff.call_off(ticket)
        if isinstance(answer, Problem):
            raise ProblemError(answer)
        return answer

    async def above(self, name: str, gone: Awaitable[None]) -> dict[str, Any]:
        """The map from above; drawn once."""
        if name not in self._above:
            self._above[name] = await self.answer(AboveJob(name), gone)
        else:
            asyncio.ensure_future(gone).cancel()
        return self._above[name]

    def health(self) -> tuple[bool, dict[str, Any]]:
        """Whether there is somebody to work, and the numbers."""
        alive = self.staff.alive
        return alive > 0, {
            "status": "ok" if alive else "no workers",
            "workers": alive,
            "busy": self.staff.busy,
            "waiting": self.staff.waiting,
        }

    def metrics_text(self) -> str:
        """For Prometheus."""
        return self.metrics.text(
            {
                "gscpe_requests_inside": ("Requests at a time.", self.gate.inside),
                "gscpe_jobs_waiting": ("Jobs that no worker has begun.", self.staff.waiting),
                "gscpe_workers_ready": ("Workers that are ready.", self.staff.alive),
                "gscpe_workers_busy": ("Workers that work.", self.staff.busy),
                "gscpe_trackers": ("Cameras that are followed.", self.trackers.inside),
            }
        )

    def photo_done(self, map_: str, answer: Mapping[str, Any], begin: float) -> None:
        """Counts a photo that was answered."""
        self.metrics.photo(map_, str(answer["status"]), time.monotonic() - begin)

    def close(self) -> None:
        self.staff.close()


def choose_service_workers(order: ShelfOrder) -> int:
    """As for a long list of photos (:func:`gscpe.batch.choose_workers`).

    Raises:
        MapError: a ``map.json`` is damaged.
    """
    return workers_for(shelf_bytes(order), order.backend, 8 * available_cores())


def _check_names(order: ShelfOrder) -> None:
    for name, folder in order.folders.items():
        if any(not (c.isalnum() or c in "-_. ") for c in name):
            raise MapError(
                f"{folder} has a name that an address cannot have; use letters, digits, - and _"
            )


def _about(name: str, folder: Path) -> dict[str, Any]:
    """What is said of a map without opening it."""
    try:
        seal = json.loads((folder / "map.json").read_text())
        gaussians, references = int(seal["gaussians"]), int(seal["references"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MapError(f"{folder / 'map.json'} is damaged; build the map again") from error
    return {"name": name, "gaussians": gaussians, "references": references}
