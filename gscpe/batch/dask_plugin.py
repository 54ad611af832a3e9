"""What runs on a Dask worker: a plugin that holds a gscpe worker in a thread of its own."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

from distributed import Worker as DaskWorker
from distributed import WorkerPlugin, get_worker

from gscpe.batch.details import Detail
from gscpe.batch.instructions import Instructions
from gscpe.batch.worker import Worker
from gscpe.errors import MapError
from gscpe.scene.query_list import Query


class LocalizerPlugin(WorkerPlugin):
    """Opens the map where it is registered, and on workers that join later; closes it at the end.

    A localizer works on one photo at a time, so one thread does all the work, however many Dask
    runs tasks in; it waits for the map, too.
    """

    def __init__(self, name: str, instructions: Instructions) -> None:
        self.name = name
        self._instructions = instructions

    def setup(self, worker: DaskWorker) -> None:
        """Begins to open the map; this is the worker's event loop, which must not wait."""
        self._address = worker.address
        if self._instructions.threads is None:
            self._instructions = replace(self._instructions, threads=worker.state.nthreads)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="gscpe-localizer")
        self._worker: Future[Worker] = self._thread.submit(self._start)

    def teardown(self, worker: DaskWorker) -> None:
        """Closes what was opened, once it is idle; in its thread."""
        self._thread.submit(self._stop)
        self._thread.shutdown(wait=False)

    def _start(self) -> Worker:
        for folder in (self._instructions.map_folder, self._instructions.image_folder):
            if not folder.is_dir():
                raise MapError(
                    f"there is no folder {folder} on the Dask worker {self._address}: workers "
                    "read the map and the photos from the same paths as the machine that asks, "
                    "so they need a shared file system"
                )
        return Worker.start(self._instructions)

    def _stop(self) -> None:
        if self._worker.exception() is None:
            self._worker.result().close()

    def description(self) -> str:
        """What renders, once the map is open."""
        return self._worker.result().description

    def localize(self, query: Query) -> Detail:
        """As :meth:`gscpe.batch.Worker.localize`, from any thread."""
        return self._thread.submit(self._worker.result().localize, query).result()


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
