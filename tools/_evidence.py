# SPDX-License-Identifier: Apache-2.0
"""Files of evidence: a line of JSON for each thing that was measured, so that a run which was
interrupted goes on where it ended; and the processes that measure."""

from __future__ import annotations

import json
import multiprocessing
import os
import time
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, TypeVar

_Job = TypeVar("_Job")
_Result = TypeVar("_Result")


def read_lines(path: Path) -> Iterator[dict[str, Any]]:
    """What is in the file, if there is one."""
    if not path.is_file():
        return
    for text in path.read_text().splitlines():
        try:
            yield json.loads(text)
        except ValueError:
            continue  # the run was killed while it wrote this line: it is measured again


def add_lines(path: Path, lines: Iterable[dict[str, Any]]) -> None:
    """Each as soon as it is measured."""
    path.touch()
    with path.open("a") as output:
        output.write(_newline_if_cut_off(path))
        for line in lines:
            output.write(json.dumps(line) + "\n")
            output.flush()


def _newline_if_cut_off(path: Path) -> str:
    """So that what follows a line whose writing was interrupted has a line of its own."""
    text = path.read_text()
    return "\n" if text and not text.endswith("\n") else ""


def in_processes(
    measure: Callable[[_Job], _Result],
    jobs: Iterable[_Job],
    processes: int,
    minutes: float,
    begin: Callable[..., None],
    arguments: tuple[Any, ...],
) -> Iterator[_Result]:
    """The results in the order in which they are done; after so many minutes, none is begun.

    Args:
        measure: of one job.
        jobs: that are to be done.
        processes: of one thread each.
        minutes: see above.
        begin, arguments: what is called first in each process.
    """
    os.environ |= dict.fromkeys(("GSCPE_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    end = time.monotonic() + 60.0 * minutes
    context = multiprocessing.get_context("spawn")
    waiting = iter(jobs)
    with ProcessPoolExecutor(processes, context, begin, arguments) as pool:
        running: set[Future[_Result]] = set()
        while True:
            while len(running) < processes and time.monotonic() <= end:
                job = next(waiting, None)
                if job is None:
                    break
                running.add(pool.submit(measure, job))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for each in done:
                yield each.result()
