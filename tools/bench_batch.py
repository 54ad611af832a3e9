#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Photos a minute of one process, of several, and of a local Dask cluster, in the same run.

Usage: GSCPE_DATA=DATA .venv/bin/python tools/bench_batch.py kitchen.gsmap [--queries N]
       [--workers 2 ...] [--rounds R] [--dask]

The crews take turns, so that whatever else the machine does falls on all of them. Starting
them (opening the map, loading libraries) is not counted, and shown beside. Processor seconds
(of all cores, workers and this process) do not depend on what else the machine does: they bound
what is possible. Memory is the sum of the workers' resident sets at the end. Both are read from
/proc (Linux).
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Iterator, Sequence

import numpy as np
from _common import read_queries, redkitchen, table

from gscpe.batch import Crew, Instructions, make_crew
from gscpe.cores import available_cores
from gscpe.geometry import pose_difference
from gscpe.poses.hloc import parse_pose
from gscpe.scene.query_list import Query


@dataclass
class Times:
    """Of one crew, a number a round."""

    seconds: list[float] = field(default_factory=list)
    start: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    megabytes: list[float] = field(default_factory=list)
    details: dict[str, Any] = field(default_factory=dict)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", help="map folder")
    parser.add_argument("--queries", type=int, default=20, help="default: %(default)s")
    parser.add_argument("--workers", type=int, nargs="+", default=[available_cores()])
    parser.add_argument("--rounds", type=int, default=2, help="default: %(default)s")
    parser.add_argument("--dask", action="store_true", help="a local Dask cluster too")
    parser.add_argument("--backend", default="cpu", help="default: %(default)s")
    options = parser.parse_args()
    data = redkitchen()
    queries = read_queries(data, options.queries)
    instructions = Instructions.of(options.map, data / "queries", backend=options.backend)
    cores = available_cores()
    kinds = [f"1 process, {cores} threads"]
    kinds += [f"{n} processes, {max(1, cores // n)} threads each" for n in options.workers]
    kinds += [f"Dask, {n} workers, 1 thread each" for n in options.workers if options.dask]
    times = {kind: Times() for kind in kinds}
    for _ in range(options.rounds):
        for kind, taken in times.items():
            _measure(kind, instructions, queries, taken)
    _print(times, len(queries))
    return 0


def _measure(kind: str, instructions: Instructions, queries: Sequence[Query], times: Times) -> None:
    begin = time.perf_counter()
    with _crew(kind, instructions) as (crew, workers):
        # A photo for each worker first: all have started then.
        for _ in crew.run(queries[: 2 * workers]):
            pass
        times.start.append(time.perf_counter() - begin)
        before = sum(map(_processor_seconds, _family()))
        begin = time.perf_counter()
        times.details = {query.name: detail for query, detail in crew.run(queries)}
        times.seconds.append(time.perf_counter() - begin)
        times.processor.append(sum(map(_processor_seconds, _family())) - before)
        working = _family() - {os.getpid()} if workers > 1 else {os.getpid()}
        times.megabytes.append(sum(map(_megabytes, working)))


@contextmanager
def _crew(kind: str, instructions: Instructions) -> Iterator[tuple[Crew, int]]:
    """A crew of this kind, and how many work in it."""
    count = int(next(word for word in kind.split() if word.isdecimal()))
    if not kind.startswith("Dask"):
        with make_crew(instructions, count) as crew:
            yield crew, count
        return
    from distributed import LocalCluster

    with (
        LocalCluster(
            n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as cluster,
        make_crew(replace(instructions, threads=1), scheduler=cluster.scheduler_address) as crew,
    ):
        yield crew, count


def _family() -> set[int]:
    """This process and those below it."""
    family, size = {os.getpid()}, 0
    while len(family) > size:  # Dask's workers are below its nannies
        size = len(family)
        family |= {pid for pid, parent in _parents().items() if parent in family}
    return family


def _parents() -> dict[int, int]:
    pids = (int(folder.name) for folder in Path("/proc").glob("[0-9]*"))
    return {pid: int(words[1]) for pid in pids if (words := _stat(pid))}


def _stat(pid: int) -> list[str]:
    """/proc/PID/stat from the state on; empty when the process has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def _processor_seconds(pid: int) -> float:
    return sum(map(int, _stat(pid)[11:13])) / os.sysconf("SC_CLK_TCK")


def _megabytes(pid: int) -> float:
    """Resident memory."""
    words = _stat(pid)
    return int(words[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6 if words else 0.0


def _print(times: dict[str, Times], count: int) -> None:
    first = next(iter(times.values()))
    print(f"{count} photos, {available_cores()} cores, {len(first.seconds)} rounds, medians\n")
    rows = []
    for kind, taken in times.items():
        numbers = (
            f"{60 * count / np.median(taken.seconds):.0f}",
            f"{np.median(np.divide(first.seconds, taken.seconds)):.2f}",
            f"{np.median(taken.processor) / count:.2f}",
            f"{np.median(taken.start):.1f}",
            f"{np.median(taken.megabytes):.0f}",
        )
        rows.append([kind, *numbers, _agreement(first.details, taken.details)])
    table(
        ["", "photos a minute", "ratio", "processor s a photo", "s to start", "memory MB",
         "poses as in one process"],
        rows,
    )  # fmt: skip


def _agreement(first: dict[str, Any], other: dict[str, Any]) -> str:
    same, apart = 0, 0.0
    for name, detail in first.items():
        a, b = detail["cam_from_world"], other[name]["cam_from_world"]
        if a == b:
            same += 1
        elif a and b:
            apart = max(apart, pose_difference(parse_pose(a), parse_pose(b)).distance)
    if same == len(first):
        return "all, in every digit"
    return f"{same} of {len(first)}; others within {1000 * apart:.3g} mm"


if __name__ == "__main__":
    sys.exit(main())
