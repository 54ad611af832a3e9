#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Times the search of many descriptors, exact and by an index (extra: index).

Synthetic places on a 32-dimensional surface with noise; queries are 0.6 to 0.8 similar to one.

Usage: .venv/bin/python tools/bench_index.py COUNT [--dimension D] [--probes N]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from typing import Callable

import numpy as np
from _common import peak_bytes, table

from gscpe.arrays import Float32Array
from gscpe.retrieval import IndexSettings, ReferenceIndex, RetrievedReference, search


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("count", type=float, help="number of descriptors, 1e6 for example")
    parser.add_argument("--dimension", type=int, default=512, help="of them, default: %(default)s")
    parser.add_argument("--probes", type=int, default=IndexSettings.probes, help="of the index")
    options = parser.parse_args()
    bench_index(int(options.count), options.dimension, options.probes)
    return 0


def bench_index(count: int, dimension: int, probes: int) -> None:
    rng = np.random.default_rng(0)
    surface = rng.normal(size=(32, dimension)).astype(np.float32) / np.sqrt(32)
    descriptors = np.empty((count, dimension), dtype=np.float32)
    for start in range(0, count, 50_000):
        part = descriptors[start : start + 50_000]
        rng.standard_normal(out=part, dtype=np.float32)
        part *= 0.3
        part += rng.standard_normal((len(part), 32), dtype=np.float32) @ surface
        part /= np.linalg.norm(part, axis=1, keepdims=True)
    queries = descriptors[rng.choice(count, 50)]
    queries = queries + (0.9 / np.sqrt(dimension)) * rng.normal(size=queries.shape)
    queries = np.asarray(queries / np.linalg.norm(queries, axis=1, keepdims=True), np.float32)
    exact, milliseconds = timed(lambda query: search(query, descriptors, 3), queries)
    alike = np.median([found[0].similarity for found in exact])
    print(
        f"{count} descriptors of {dimension}, {os.cpu_count()} cores; queries are similar to "
        f"their reference by {alike:.2f}\n"
    )
    rows = [["matrix product", "0", f"{milliseconds:.1f}", "1", "1", f"{peak_bytes() / 1e9:.1f}"]]
    begin = time.perf_counter()
    index = ReferenceIndex(descriptors, IndexSettings(0, exact_queries=0, probes=probes))
    seconds = time.perf_counter() - begin
    found, milliseconds = timed(lambda query: index.search(query, 3), queries)
    pairs = [
        ([each.index for each in a], [each.index for each in b])
        for a, b in zip(exact, found, strict=True)
    ]
    first = np.mean([a[0] == b[0] for a, b in pairs])
    three = np.mean([len({*a} & {*b}) / 3 for a, b in pairs])
    rows.append(
        [f"index, {probes} probes", f"{seconds:.0f}", f"{milliseconds:.1f}", f"{first:.2f}",
         f"{three:.2f}", f"{peak_bytes() / 1e9:.1f}"]
    )  # fmt: skip
    table(["search", "build s", "ms a query", "recall@1", "recall@3", "peak memory GB"], rows)


def timed(
    function: Callable[[Float32Array], tuple[RetrievedReference, ...]], queries: Float32Array
) -> tuple[list[tuple[RetrievedReference, ...]], float]:
    """The results, and the median of the milliseconds of one."""
    results, seconds = [], []
    for query in queries:
        begin = time.perf_counter()
        results.append(function(query))
        seconds.append(time.perf_counter() - begin)
    return results, 1000 * float(np.median(seconds))


if __name__ == "__main__":
    sys.exit(main())
