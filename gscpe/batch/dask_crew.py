# SPDX-License-Identifier: Apache-2.0
"""The crew of a cluster: the workers of a Dask scheduler, and what runs on them.

This needs Dask to be imported; :func:`gscpe.batch.make_crew` does so where a scheduler is given.
"""

from __future__ import annotations

import logging
import math
import threading
import uuid
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from queue import Empty, SimpleQueue
from typing import Any, Iterator, Sequence

from distributed import Client, KilledWorker, WorkerPlugin, get_worker
from distributed import Worker as DaskWorker

from gscpe.batch.crew import Crew
from gscpe.batch.details import Detail, failed_details
from gscpe.batch.instructions import Instructions
from gscpe.batch.start import start_worker
from gscpe.batch.worker import QueryWorker
from gscpe.errors import MapError, SettingsError, WorkerError
from gscpe.scene.query_list import Query

_log = logging.getLogger(__name__)

_LOOK = 5.0
"""Seconds without news after which it is looked whether there are workers."""

_PATIENCE = 60.0
"""Seconds that a scheduler may be without workers."""


class DaskCrew(Crew):
    """Implements :class:`gscpe.batch.Crew`; the scheduler moves queries of workers that die.

    Every Dask worker holds one localizer, workers that join later too, and reads map and
    photos from the paths in the instructions: all machines need the same shared folders, and
    the same version of gscpe.

    Args:
        instructions: for all workers; without threads, each uses as many as Dask gave it.
        scheduler: its address, for example ``tcp://10.0.0.1:8786``.

    Raises:
        SettingsError: the address is none.
        WorkerError: the scheduler cannot be reached, or has no workers.
        MapError, RenderError, ...: what :func:`gscpe.batch.start_worker` raised in one of them.
    """

    def __init__(self, instructions: Instructions, scheduler: str) -> None:
        self.fingerprint = instructions.fingerprint
        self.image_folder = instructions.image_folder
        self._scheduler = scheduler
        self._registered = False
        self._name = f"gscpe-{uuid.uuid4().hex}"
        try:
            self._client = Client(scheduler, set_as_default=False)
        except ValueError as error:
            raise SettingsError(f"--scheduler {scheduler}: {error}") from error
        except OSError as error:
            raise WorkerError(f"the Dask scheduler {scheduler} cannot be reached") from error
        try:
            self._wait_for_a_worker()
            self._client.register_plugin(LocalizerPlugin(self._name, instructions))
            self._registered = True
            key = f"{self._name}-describe"
            started = self._client.submit(describe_on_worker, self._name, key=key)
            self._renderer: str = self._outcome(self._next(_when_done([started])))
        except KilledWorker as error:
            self.close()
            raise WorkerError(f"Dask workers crash while opening the map ({error})") from error
        except BaseException:
            self.close()
            raise

    @property
    def description(self) -> str:
        return f"{self._count()} Dask workers at {self._scheduler}, the first: {self._renderer}"

    def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
        tag = f"{self._name}-{uuid.uuid4().hex}"
        keys = [f"{tag}-{number}" for number in range(len(queries))]
        futures = self._client.map(localize_on_worker, queries, name=self._name, key=keys)
        done = _when_done(futures)
        pending = dict(zip(keys, queries, strict=True))
        del futures  # those that are finished are forgotten, on the scheduler too
        while pending:
            future = self._next(done)
            query = pending.pop(future.key)
            try:
                detail: Detail = self._outcome(future)
            except KilledWorker as error:
                _log.warning("giving up on %s: %s", query.name, error)
                detail = failed_details(query, f"its Dask workers died repeatedly ({error})")
            yield query, detail

    def _next(self, done: SimpleQueue[Any]) -> Any:
        """The next future that is done; looks from time to time whether there are workers."""
        while True:
            try:
                return done.get(timeout=_LOOK)
            except Empty:
                self._wait_for_a_worker()

    def _outcome(self, future: Any) -> Any:
        if future.cancelled():
            raise WorkerError(f"the connection to the Dask scheduler {self._scheduler} was lost")
        try:
            return future.result(timeout=_PATIENCE)
        except TimeoutError as error:  # its worker died, and there is no other one
            raise WorkerError(f"a result cannot be fetched from {self._scheduler}") from error

    def _wait_for_a_worker(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError as error:
            raise WorkerError(
                f"the Dask scheduler {self._scheduler} has had no workers for {_PATIENCE:.0f} s"
            ) from error
        except OSError as error:
            raise WorkerError(
                f"the Dask scheduler {self._scheduler} does not answer any more"
            ) from error

    def _count(self) -> int:
        return len(self._client.nthreads())

    def close(self) -> None:
        try:
            if self._registered:
                self._client.unregister_worker_plugin(self._name)
        except (OSError, RuntimeError) as error:  # nobody is there, so nothing is open
            _log.debug("the Dask scheduler does not answer any more: %s", error)
        self._registered = False
        self._client.close()


def _when_done(futures: Sequence[Any]) -> SimpleQueue[Any]:
    """Futures come out in the order in which they are done."""
    done: SimpleQueue[Any] = SimpleQueue()
    for future in futures:
        future.add_done_callback(done.put)
    return done


class LocalizerPlugin(WorkerPlugin):
    """Opens the map where it is registered, and on workers that join later; closes it at the end.

    An OpenGL context belongs to its thread, so one thread does all the work, however many Dask
    runs tasks in. One that hangs is left behind, and a new one opens the map again.
    """

    def __init__(self, name: str, instructions: Instructions) -> None:
        self.name = name
        self._instructions = instructions

    def setup(self, worker: DaskWorker) -> None:
        """Begins to open the map; this is the worker's event loop, which must not wait."""
        self._address = worker.address
        if self._instructions.threads is None:
            self._instructions = replace(self._instructions, threads=worker.state.nthreads)
        self._turn = threading.Lock()  # whose time runs is the one that is worked on
        self._begin()

    def _begin(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="gscpe-localizer")
        self._worker: Future[QueryWorker] = self._thread.submit(self._start)

    def teardown(self, worker: DaskWorker) -> None:
        """Closes what was opened, once it is idle; in its thread."""
        self._end()

    def _start(self) -> QueryWorker:
        shelf = self._instructions.shelf
        maps = [self._instructions.map_folder] if shelf is None else shelf.folders.values()
        for folder in (*maps, self._instructions.image_folder):
            if not folder.is_dir():
                raise MapError(
                    f"there is no folder {folder} on the Dask worker {self._address}: workers "
                    "read the map and the photos from the same paths as the machine that runs "
                    "this command, so they need a shared file system"
                )
        return start_worker(self._instructions)

    def _end(self) -> None:
        """Has the thread close what it opened, when it comes to that, and does not wait."""
        self._thread.submit(_close, self._worker)
        self._thread.shutdown(wait=False)

    def description(self) -> str:
        """What renders, once the map is open."""
        return self._worker.result().description

    def localize(self, query: Query) -> Detail:
        """As :meth:`gscpe.batch.Worker.localize`, from any thread; or failed, after the time
        that the instructions allow."""
        seconds = self._instructions.timeout
        with self._turn:
            found = self._thread.submit(self._worker.result().localize, query)
            wait([found], seconds if math.isfinite(seconds) else None)
            if not found.done():
                self._end()
                self._begin()
                return failed_details(query, f"its worker hung (no answer for {seconds:g} s)")
        return found.result()


def _close(worker: Future[QueryWorker]) -> None:
    if worker.exception() is None:
        worker.result().close()


def describe_on_worker(name: str) -> str:
    """A Dask task: waits until the map is open."""
    return _plugin(name).description()


def localize_on_worker(query: Query, name: str) -> Detail:
    """A Dask task."""
    return _plugin(name).localize(query)


def _plugin(name: str) -> LocalizerPlugin:
    plugin = get_worker().plugins[name]
    assert isinstance(plugin, LocalizerPlugin)
    return plugin
