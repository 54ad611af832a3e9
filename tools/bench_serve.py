#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""gscpe serve under load: answers, photos a minute beside a batch's, memory, mutated requests.

Usage: GSCPE_DATA=DATA .venv/bin/python tools/bench_serve.py kitchen.gsmap [--requests N]
       [--clients 50] [--photos 10] [--workers N] [--rounds R] [--mutated 500] [--timeout SECONDS]

1. A batch (gscpe.batch, as many workers) and the service take turns with the same photos, so that
   whatever else the machine does falls on both; starting them is not counted.
2. The service gets the requests, in ten parts; after each, the resident sets of all its processes
   are added up (from /proc).
3. Mutated requests (serve_mutants.py) and good ones, one for every two, come at once; one worker is
   killed then, and one is stopped, which must be noticed after --timeout seconds.

Every good answer is compared with the batch's, digit by digit. The exit status is 0 if no answer
was lost, mixed up or different, if each mutated request had an answer or a typed error below 500
(or 503), and if as many workers are ready at the end as at the start.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any, Iterator, Sequence

from _common import progress, read_queries, redkitchen, table
from serve_mutants import KINDS, Verdict, mutants, verdict_of

from gscpe import Client
from gscpe.batch import Crew, Instructions, make_crew
from gscpe.cores import available_cores
from gscpe.scene.query_list import Query

_COMPARED = ("status", "reason", "cam_from_world", "covariance", "reference")
_PARTS = 10


@dataclass
class Asked:
    """A service, what it is asked, and what it should say.

    Attributes:
        expected: details by photo, of a batch.
        wrong: what was wrong with answers so far.
    """

    client: Client
    url: str
    pid: int
    map: str
    photos: Path
    clients: int
    expected: dict[str, dict[str, Any]] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)

    def ask(self, queries: Sequence[Query]) -> float:
        """Photos a minute, of so many clients at once."""
        begin = time.perf_counter()
        with ThreadPoolExecutor(self.clients) as pool:
            for _ in progress(pool.map(self.compare, queries), "served", len(queries)):
                pass
        return 60 * len(queries) / (time.perf_counter() - begin)

    def compare(self, query: Query) -> None:
        """One photo; a wrong answer is printed and counted."""
        try:
            answer = self.client.localize(self.map, self.photos / query.name, query.camera)
        except Exception as error:  # whatever it is, it is no answer
            self._is_wrong(f"{query.name}: {type(error).__name__}: {error}")
            return
        expected = self.expected.get(query.name, answer)
        other = [key for key in _COMPARED if answer[key] != expected[key]]
        if other or answer["name"] != Path(query.name).name:
            self._is_wrong(f"{query.name}: {answer['name']} differs in {', '.join(other)}")

    def _is_wrong(self, text: str) -> None:
        print(text, flush=True)
        self.wrong.append(text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", help="map folder")
    parser.add_argument("--requests", type=int, default=100, help="default: %(default)s")
    parser.add_argument("--clients", type=int, default=50, help="at once; default: %(default)s")
    parser.add_argument("--photos", type=int, default=10, help="different ones (%(default)s)")
    parser.add_argument("--workers", type=int, default=available_cores())
    parser.add_argument("--rounds", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--mutated", type=int, default=500, help="default: %(default)s")
    parser.add_argument("--timeout", type=int, default=120, help="default: %(default)s")
    parser.add_argument("--backend", default="cpu", help="default: %(default)s")
    options = parser.parse_args()
    photos = redkitchen() / "queries"
    queries = read_queries(photos.parent, options.photos)
    instructions = Instructions.of(options.map, photos, backend=options.backend)
    name = Path(options.map).name.removesuffix(".gsmap")
    began = time.perf_counter()
    with (
        make_crew(instructions, options.workers) as crew,
        served(options) as (url, pid),
        Client(url, timeout=3600) as client,
    ):
        asked = Asked(client, url, pid, name, photos, options.clients)
        take_turns(asked, crew, queries, options.workers, options.rounds)
        crew.close()
        load(asked, queries, options.requests)
        fine = disturb(asked, queries, options.mutated, options.workers)
    seconds = time.perf_counter() - began
    print(f"{len(asked.wrong)} good requests answered wrong; {seconds:.0f} s in all")
    return 0 if fine and not asked.wrong else 1


@contextmanager
def served(options: argparse.Namespace) -> Iterator[tuple[str, int]]:
    """Address and process id of a service; what it logs is passed on."""
    command = [sys.executable, "-m", "gscpe", "serve", options.map, "--port", "0"]
    command += ["--workers", str(options.workers), "--queue", str(2 * options.clients)]
    command += ["--timeout", str(options.timeout), "--backend", options.backend]
    process = Popen(command, stderr=PIPE, text=True)
    assert process.stderr is not None
    log = process.stderr
    try:
        for line in log:
            if line.startswith("gscpe serve: http"):
                threading.Thread(target=sys.stderr.writelines, args=(log,), daemon=True).start()
                yield line.split()[2].rstrip(","), process.pid
                return
        raise SystemExit("the service did not start")
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(60)


def take_turns(
    asked: Asked, crew: Crew, queries: Sequence[Query], workers: int, rounds: int
) -> None:
    """Batch and service, the same photos; so many that no worker waits for the last ones long."""
    asked.expected = {query.name: detail for query, detail in crew.run(queries)}
    asked.ask(repeated(queries, max(len(queries), 2 * workers)))  # compiled, cached
    many, rows = repeated(queries, max(len(queries), 8 * workers)), []
    for number in range(rounds):
        begin = time.perf_counter()
        for query, detail in crew.run(many):
            if detail["cam_from_world"] != asked.expected[query.name]["cam_from_world"]:
                raise SystemExit(f"{query.name}: the batch contradicts itself")
        batch = 60 * len(many) / (time.perf_counter() - begin)
        service = asked.ask(many)
        rows.append([f"{number + 1}", f"{batch:.1f}", f"{service:.1f}", f"{service / batch:.2f}"])
    print(f"{workers} workers, {len(many)} photos a round\n")
    table(["round", "batch, photos a minute", "service", "ratio"], rows)


def load(asked: Asked, queries: Sequence[Query], requests: int) -> None:
    """All requests, and the memory after each tenth of them."""
    before, rows, done = len(asked.wrong), [], 0
    print(f"\nmemory of all processes: {megabytes(asked.pid):.0f} MB before\n")
    for part in range(1, _PARTS + 1):
        count = part * requests // _PARTS - done
        if count:
            speed = asked.ask(repeated(queries, done + count)[done:])
            done += count
            rows.append([f"{done}", f"{megabytes(asked.pid):.0f}", f"{speed:.1f}"])
    table(["requests", "MB", "photos a minute"], rows)
    wrong = len(asked.wrong) - before
    print(f"\n{done} requests of {asked.clients} clients at once: {wrong} wrong", flush=True)


def disturb(asked: Asked, queries: Sequence[Query], mutated: int, workers: int) -> bool:
    """Mutated requests, good ones among them, while a worker dies and another hangs; whether each
    had an answer that it may have, and as many workers are there at the end."""
    import httpx

    address = f"{asked.url}/v1/maps/{asked.map}/localize"
    counts = {kind: Verdict() for kind in KINDS}
    good = repeated(queries, (mutated + 1) // 2)
    before = replaced(asked)
    with httpx.Client(timeout=3600, limits=httpx.Limits(max_connections=None)) as client:

        def send(number: int) -> None:
            kind, request = mutant(number)
            try:
                counts[kind].add(verdict_of(client.send(request)))
            except httpx.TransportError as error:
                counts[kind].add(f"no answer: {error}")

        mutant = mutants(address, asked.photos / queries[0].name, queries[0].camera)
        with ThreadPoolExecutor(asked.clients) as pool:
            works = []
            for number in range(mutated):
                works.append(pool.submit(send, number))
                if number % 2 == 0:
                    works.append(pool.submit(asked.compare, good[number // 2]))
            if mutated:
                break_workers(asked.pid)
            for work in progress(works, "mutated", len(works)):
                work.result()
    print(f"\n{mutated} mutated requests, {len(good)} good ones among them\n")
    table(["mutated", *Verdict.names], [[kind, *counts[kind].texts()] for kind in KINDS])
    for kind in KINDS:
        for text in counts[kind].wrong:
            print(f"{kind}: {text}")
    new = replaced(asked) - before
    ready = wait_for_workers(asked, workers)
    print(f"\n{new} workers replaced (1 was killed, 1 stopped); {ready} of {workers} ready")
    return ready == workers and not any(counts[kind].wrong for kind in KINDS)


def repeated(queries: Sequence[Query], count: int) -> list[Query]:
    """So many, over and over."""
    return [queries[i % len(queries)] for i in range(count)]


def break_workers(pid: int) -> None:
    """Kills one and stops another, a moment after they were given something."""
    time.sleep(1.0)
    workers = [
        p for p in processes(pid) if b"spawn_main" in Path(f"/proc/{p}/cmdline").read_bytes()
    ]
    os.kill(workers[0], signal.SIGKILL)
    if len(workers) > 1:
        os.kill(workers[-1], signal.SIGSTOP)


def replaced(asked: Asked) -> int:
    """Workers that the service has replaced so far."""
    import httpx

    lines = httpx.get(f"{asked.url}/metrics", timeout=60).text.splitlines()
    return int(next(x for x in lines if x.startswith("gscpe_workers_replaced_total")).split()[1])


def wait_for_workers(asked: Asked, workers: int) -> int:
    """How many are ready, once they all are or two minutes are over."""
    import httpx

    end = time.monotonic() + 120
    while True:
        ready = int(httpx.get(f"{asked.url}/health", timeout=60).json()["workers"])
        if ready == workers or time.monotonic() > end:
            return ready
        time.sleep(0.5)


def processes(pid: int) -> list[int]:
    """A process, its children, and theirs."""
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                words = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:  # it has just ended
                continue
            children.setdefault(int(words[1]), []).append(int(folder.name))
    found = [pid]
    for one in found:
        found += children.get(one, [])
    return found


def megabytes(pid: int) -> float:
    """Resident memory of a process, its children, and theirs."""
    pages = 0
    for one in processes(pid):
        try:
            pages += int(Path(f"/proc/{one}/statm").read_text().split()[1])
        except OSError:
            continue
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    sys.exit(main())
