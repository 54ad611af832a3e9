# SPDX-License-Identifier: Apache-2.0
"""Which crew does the work."""

from __future__ import annotations

import importlib
import logging
from pathlib import Path

from gscpe.batch.crew import Crew, SerialCrew
from gscpe.batch.instructions import Instructions
from gscpe.batch.process_crew import ProcessCrew
from gscpe.batch.shelf import map_bytes, shelf_bytes
from gscpe.batch.start import start_worker
from gscpe.cores import available_cores
from gscpe.errors import MissingDependencyError, SettingsError
from gscpe.render import choose_backend

_log = logging.getLogger(__name__)

_PHOTOS_A_WORKER = 8
"""Fewer than these are localized in the time that one more worker takes to start."""

_BYTES = 500_000_000
"""Memory of a worker on the CPU, beside its map; from what tools/bench_batch.py measures."""


_MOST, _MOST_A_CORE = 16, 8
"""More workers, altogether or for each core, are a mistake: they only take memory and time."""


def make_crew(
    instructions: Instructions,
    workers: int = 1,
    scheduler: str | None = None,
    progress: bool = False,
    photos: int | None = None,
) -> Crew:
    """The crew that was asked for, ready to work.

    Args:
        instructions: of the workers.
        workers: processes on this machine; 1: this one.
        scheduler: address of a Dask scheduler, whose workers are taken instead.
        progress: show a bar when this process compiles the CPU rasterizer.
        photos: how many there are to localize, where that is known; no more processes are started.

    Raises:
        SettingsError: the number of workers is none, or far more than the cores can serve; or the
            address is none.
        WorkerError: the workers do not start, or the scheduler cannot be reached.
        MissingDependencyError: ``scheduler`` without Dask, or ``backend="cpu"`` without Numba.
        GscpeError: what else :func:`gscpe.batch.start_worker` raises.
    """
    if photos is not None and workers > 1:
        workers = min(workers, max(1, photos))
    check_workers(workers)
    if scheduler is not None:
        try:
            importlib.import_module("distributed")
        except ImportError as error:
            raise MissingDependencyError(
                f"a cluster needs Dask ({error}): pip install 'gscpe[dask]'"
            ) from error
        from gscpe.batch.dask_crew import DaskCrew

        return DaskCrew(instructions, scheduler)
    if workers > 1:
        return ProcessCrew(instructions, workers)
    return SerialCrew(start_worker(instructions, progress), instructions.fingerprint)


def check_workers(workers: int) -> None:
    """Warns of more processes than cores, which are not faster and need more memory.

    Raises:
        SettingsError: there are none, or so many that the machine would break down.
    """
    if workers < 1:
        raise SettingsError(f"there must be at least one worker, not {workers}")
    cores = available_cores()
    most = max(_MOST, _MOST_A_CORE * cores)
    if workers > most:
        raise SettingsError(
            f"{workers} workers are too many for {cores} cores; at most {most}, and more than "
            f"{cores} are hardly faster"
        )
    if workers > cores:
        _log.warning(
            "%d workers on %d cores are hardly faster than %d, and need more memory",
            *(workers, cores, cores),
        )


def choose_workers(instructions: Instructions, queries: int) -> int:
    """How many processes finish a list soonest on this machine.

    On the CPU, a process for each core with one thread is faster than one process with a thread
    for each core (docs/batch.md); each needs memory for a map of its own (of several maps, for
    those that it holds), and time to start. On a GPU: one.

    Raises:
        MapError: the ``map.json`` of a map is damaged.
        RenderError, SettingsError: as gscpe.render.choose_backend.
    """
    shelf = instructions.shelf
    needed = map_bytes(instructions.map_folder) if shelf is None else shelf_bytes(shelf)
    return workers_for(needed, instructions.backend, queries)


def workers_for(needed: int, backend: str, queries: int) -> int:
    """As :func:`choose_workers`, of workers whose maps take so many bytes.

    Raises:
        RenderError, SettingsError: as gscpe.render.choose_backend.
    """
    most = min(available_cores(), queries // _PHOTOS_A_WORKER)
    if most <= 1 or choose_backend(backend) == "gl":
        return 1
    free = _free_memory()
    return most if free is None else max(1, min(most, free // (_BYTES + needed)))


def _free_memory() -> int | None:
    """Bytes, or None where the system does not tell (only Linux does)."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        free = next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration, ValueError, IndexError):
        return None
    return 1024 * free
