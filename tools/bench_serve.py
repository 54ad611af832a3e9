#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""gscpe serve under load: answers, photos a minute beside a batch's, memory, mutated requests.

Usage: GSCPE_DATA=DATA .venv/bin/python tools/bench_serve.py kitchen.gsmap [--requests N]
       [--clients 50] [--photos 10] [--workers N] [--rounds R] [--mutated 500]

A batch (gscpe.batch, as many workers) and the service take turns with the same photos, so that
whatever else the machine does falls on both; starting them is not counted. Every answer of the
service is compared with the batch's, digit by digit. Then the service gets the rest of the
requests, and its memory (the resident sets of all its processes, from /proc) is read on the way;
then requests with random bytes in random places. The exit status is 0 if nothing was lost or mixed
up, and nothing failed.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterator, Sequence

import numpy as np
from _common import progress, read_queries, redkitchen, table

from gscpe import Client
from gscpe.batch import Instructions, make_crew
from gscpe.cores import available_cores
from gscpe.scene.query_list import Query

_COMPARED = ("status", "reason", "cam_from_world", "covariance", "reference")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", help="map folder")
    parser.add_argument("--requests", type=int, default=100, help="default: %(default)s")
    parser.add_argument("--clients", type=int, default=50, help="at once; default: %(default)s")
    parser.add_argument("--photos", type=int, default=10, help="different ones (%(default)s)")
    parser.add_argument("--workers", type=int, default=available_cores())
    parser.add_argument("--rounds", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--mutated", type=int, default=500, help="default: %(default)s")
    options = parser.parse_args()
    data = redkitchen()
    queries = read_queries(data, options.photos)
    instructions = Instructions.of(options.map, data / "queries")
    name = Path(options.map).name.removesuffix(".gsmap")
    rows, wrong = [], 0
    with (
        make_crew(instructions, options.workers) as crew,
        served(options.map, options.workers, options.clients) as (url, pid),
        Client(url, timeout=3600) as client,
    ):
        list(crew.run(queries[: options.workers]))  # compiled, cached
        ask_all(client, name, data, queries[: options.workers], options.clients)
        for number in range(options.rounds):
            begin = time.perf_counter()
            expected = {query.name: detail for query, detail in crew.run(queries)}
            batch = 60 * len(queries) / (time.perf_counter() - begin)
            begin = time.perf_counter()
            answers = ask_all(client, name, data, queries, options.clients)
            service = 60 * len(queries) / (time.perf_counter() - begin)
            wrong += mistakes(answers, expected)
            rows.append([f"{number + 1}", f"{batch:.1f}", f"{service:.1f}"])
            rows[-1].append(f"{service / batch:.2f}")
        crew.close()
        table(["round", "batch, photos a minute", "service", "ratio"], rows)
        memory, done = [megabytes(pid)], 0
        while done < options.requests:
            some = [queries[(done + i) % len(queries)] for i in range(options.clients)]
            some = some[: options.requests - done]
            wrong += mistakes(ask_all(client, name, data, some, options.clients), expected)
            done += len(some)
            memory.append(megabytes(pid))
        print(
            f"\n{done} requests of {options.clients} clients at once: {wrong} answers wrong",
            flush=True,
        )
        sizes = ", ".join(f"{size:.0f}" for size in memory)
        print(f"memory of all processes, MB: {sizes}", flush=True)
        statuses = mutate(url, name, data, queries[0], options.mutated)
        print(f"{options.mutated} mutated requests: {dict(sorted(statuses.items()))}")
        wrong += sum(count for status, count in statuses.items() if status >= 500)
        wrong += mistakes(ask_all(client, name, data, queries[:2], 2), expected)
    return 1 if wrong else 0


@contextmanager
def served(map_: str, workers: int, clients: int) -> Iterator[tuple[str, int]]:
    """Address and process id of a service."""
    command = [sys.executable, "-m", "gscpe", "serve", map_, "--port", "0"]
    command += ["--workers", str(workers), "--queue", str(2 * clients), "--timeout", "600"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        for line in process.stderr:
            if line.startswith("gscpe serve: http"):
                yield line.split()[2].rstrip(","), process.pid
                return
        raise SystemExit("the service did not start")
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(60)


def ask_all(
    client: Client, map_: str, data: Path, queries: Sequence[Query], clients: int
) -> list[tuple[Query, dict[str, Any]]]:
    """All queries, so many at once."""

    def ask(query: Query) -> tuple[Query, dict[str, Any]]:
        return query, client.localize(map_, data / "queries" / query.name, query.camera)

    with ThreadPoolExecutor(clients) as pool:
        return list(progress(pool.map(ask, queries), "served", len(queries)))


def mistakes(
    answers: Sequence[tuple[Query, dict[str, Any]]], expected: dict[str, dict[str, Any]]
) -> int:
    """Answers that are not what the batch says."""
    wrong = 0
    for query, answer in answers:
        other = [key for key in _COMPARED if answer[key] != expected[query.name][key]]
        if other or answer["name"] != Path(query.name).name:
            print(f"{query.name}: {answer['name']} differs in {', '.join(other)}")
            wrong += 1
    return wrong


def megabytes(pid: int) -> float:
    """Resident memory of a process and its children, and theirs."""
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                words = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:  # it has just ended
                continue
            children.setdefault(int(words[1]), []).append(int(folder.name))
    todo, pages = [pid], 0
    while todo:
        one = todo.pop()
        todo += children.get(one, [])
        try:
            pages += int(Path(f"/proc/{one}/statm").read_text().split()[1])
        except OSError:
            continue
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def mutate(url: str, map_: str, data: Path, query: Query, count: int) -> Counter[int]:
    """Statuses of requests with random bytes, cut off, or too long."""
    import httpx

    rng = np.random.default_rng(0)
    address = f"{url}/v1/maps/{map_}/localize"
    request = httpx.Request(
        "POST",
        address,
        files={"photo": (query.name, (data / "queries" / query.name).read_bytes())},
        data={"camera": query.camera.colmap_text(), "prior": "1 0 0 0 0 0 0"},
    )
    body, kind = request.read(), request.headers["content-type"]
    statuses = Counter[int]()
    with httpx.Client(timeout=600) as client:
        for number in progress(range(count), "mutated", count):
            mutated = bytearray(body)
            reach = [len(body), 2000, 200][number % 3]  # the photo's pixels, its header, the form
            for at in rng.integers(0, reach, rng.integers(1, 40)):
                mutated[at] = rng.integers(0, 256)
            if number % 5 == 4:
                mutated = mutated[: rng.integers(0, len(mutated))]
            try:
                answer = client.post(
                    address, content=bytes(mutated), headers={"content-type": kind}
                )
                statuses[answer.status_code] += 1
            except httpx.TransportError:
                statuses[599] += 1
    return statuses


if __name__ == "__main__":
    sys.exit(main())
