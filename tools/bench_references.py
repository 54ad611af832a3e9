#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How many of the RedKitchen queries of $GSCPE_DATA are localized where reference photos are few.

For each --every N and each --retrieval, a map with one reference of N is made, as gscpe build-map
makes it: VLAD's words are learned from these photos alone. The queries are localized in it by as
many processes as --jobs says, with the default settings.

Usage: .venv/bin/python tools/bench_references.py MAP [--every 1 3 10]
           [--retrieval vlad vlad-xfeat onnx:PATH] [--queries N] [--jobs N]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Iterator

import numpy as np
from _common import error_of, median_error, progress, read_queries, redkitchen, table, within

from gscpe import LocalizerSettings, Map, open_map, save_map
from gscpe.batch import Instructions, make_crew
from gscpe.mapping import MapSettings, build_map
from gscpe.poses import read_pose_file
from gscpe.poses.hloc import parse_pose
from gscpe.retrieval import check_method, parse_method


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--every", type=int, nargs="+", default=[10], metavar="N")
    parser.add_argument("--retrieval", nargs="+", default=["vlad"], metavar="METHOD")
    parser.add_argument("--queries", type=int, default=100, help="so many, evenly spaced")
    parser.add_argument("--jobs", type=int, default=1, help="processes, default: %(default)s")
    options = parser.parse_args()
    for method in options.retrieval:
        check_method(method)
    data = redkitchen()
    table(
        ["retrieval", "references", "localized", "5 cm/5°", "final, median", "at the first attempt",
         "attempts, mean"],
        rows(open_map(options.map), data, options),
    )  # fmt: skip
    return 0


def rows(map_: Map, data: Path, options: argparse.Namespace) -> Iterator[list[str]]:
    for every in options.every:
        for method in options.retrieval:
            few = with_few_references(map_, data, every, method)
            yield [method, str(len(few.references)), *localized(few, data, method, options)]


def with_few_references(map_: Map, data: Path, every: int, method: str) -> Map:
    """The map with one reference of so many; its frame does not change."""
    known = map_.world_references
    kept = replace(
        known,
        names=known.names[::every],
        cam_from_world=known.cam_from_world[::every],
        cameras=known.cameras[::every],
    )
    described = build_map(map_.scene, kept, data / "references", MapSettings(method)).descriptors
    return replace(map_, references=map_.frame.references_in_map(kept), descriptors=described)


def localized(map_: Map, data: Path, method: str, options: argparse.Namespace) -> list[str]:
    """The columns of one map."""
    truth = read_pose_file(data / "truth.txt").poses
    queries = read_queries(data, options.queries)
    kind, path = parse_method(method)
    settings = LocalizerSettings(retrieval_model=path if kind == "onnx" else None)
    errors, attempts = [], []
    with tempfile.TemporaryDirectory() as folder:
        save_map(map_, Path(folder) / "few.gsmap")
        told = Instructions.of(Path(folder) / "few.gsmap", data / "queries", settings)
        with make_crew(told, options.jobs) as crew:
            for query, detail in progress(crew.run(queries), method, len(queries)):
                pose = detail["cam_from_world"]
                found = None if pose is None else parse_pose(pose)
                errors.append(error_of(found, truth[query.name]))
                attempts.append(detail.get("hypotheses", 0))
    count = sum(np.isfinite(error.centimetres) for error in errors)
    return [
        f"{count} of {len(queries)}",
        within(errors, 5.0, 5.0),
        median_error(errors),
        str(sum(n == 1 for n in attempts)),
        f"{np.mean(attempts):.2f}",
    ]


if __name__ == "__main__":
    sys.exit(main())
