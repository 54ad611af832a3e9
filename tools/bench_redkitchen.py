#!/usr/bin/env python3
"""Localizes the RedKitchen queries of $GSCPE_DATA and prints the README's table.

Usage: .venv/bin/python tools/bench_redkitchen.py [--every N] [--compress] [--output FOLDER]

With --compress the map is saved compressed and opened again first, and its size is compared.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from gscpe.batch import localize_list, write_poses
from gscpe.evaluation import THRESHOLDS, evaluate, normalized_error_squared
from gscpe.geometry import pose_difference
from gscpe.localization.localizer import Localizer
from gscpe.mapping import build_map
from gscpe.scene import Map, open_map, read_splat, save_map
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.poses.hloc import parse_pose, read_poses
from gscpe.scene.query_list import read_query_list


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=1, help="only every N-th query")
    parser.add_argument("--compress", action="store_true", help="use a compressed map")
    parser.add_argument(
        "--output", type=Path, default=Path("redkitchen-results"), help="default: %(default)s"
    )
    options = parser.parse_args()
    data = Path(os.environ.get("GSCPE_DATA", "")) / "redkitchen"
    if not data.is_dir():
        print("set GSCPE_DATA to the folder that holds redkitchen/", file=sys.stderr)
        return 2
    references = read_colmap_references(data / "sparse" / "0", data / "references")
    map_ = build_map(read_splat(data / "splat.ply"), references, data / "references", progress=True)
    if options.compress:
        map_ = _compressed(map_)
    queries = read_query_list(data / "queries.txt")[:: options.every]
    names = {query.name for query in queries}
    truth = {n: pose for n, pose in read_poses(data / "truth.txt").items() if n in names}
    options.output.mkdir(parents=True, exist_ok=True)
    with Localizer(map_) as localizer:
        details = localize_list(
            localizer,
            queries,
            data / "queries",
            options.output / "details.jsonl",
            progress=True,
        )
        renderer = localizer.renderer_description
    print(f"{len(queries)} queries, {renderer}, {os.cpu_count()} cores")
    print()
    limits = " | ".join(f"{100 * m:.0f} cm/{d:.0f}°" for m, d in THRESHOLDS)
    print(f"| | localized | median | {limits} |")
    print("|---|---|---|" + "---|" * len(THRESHOLDS))
    for stage, label in (
        ("coarse", "coarse"),
        ("aligned", "aligned"),
        ("final", "final"),
    ):
        path = options.output / f"{stage}.txt"
        write_poses(details, path, stage)
        result = evaluate(read_poses(path), truth)
        shares = " | ".join(f"{100 * share:.0f}%" for share in result.shares)
        print(
            f"| {label} | {result.localized} of {result.queries} | "
            f"{100 * result.median_distance:.3f} cm / {result.median_degrees:.3f}° | {shares} |"
        )
    print()
    print(_seconds(details))
    errors = [
        normalized_error_squared(parse_pose(d["cam_from_world"]), d["covariance"], truth[d["name"]])
        for d in details
        if d["status"] == "localized"
    ]
    worse = [
        pose_difference(parse_pose(d["cam_from_world"]), truth[d["name"]]).distance
        - pose_difference(parse_pose(d["coarse"]["cam_from_world"]), truth[d["name"]]).distance
        for d in details
        if d["status"] == "localized" and d["coarse"]
    ]
    print(f"most that refinement made a query worse: {100 * max(worse):.2f} cm")
    print(f"normalized error squared: mean {np.mean(errors):.2f}, median {np.median(errors):.2f}")
    return 0


def _compressed(map_: Map) -> Map:
    """The map after it was saved compressed and opened; prints the sizes of both kinds."""
    with tempfile.TemporaryDirectory() as folder:
        for name, compress in (("plain", False), ("compressed", True)):
            path = Path(folder) / name
            save_map(map_, path, compress=compress)
            begin = time.perf_counter()
            opened = open_map(path)
            seconds = time.perf_counter() - begin
            sizes = {file.name: file.stat().st_size for file in sorted(path.iterdir())}
            files = ", ".join(f"{file} {size / 1e6:.2f}" for file, size in sizes.items())
            print(f"{name} map: {sum(sizes.values()) / 1e6:.1f} MB ({files}), ", end="")
            print(f"opened in {seconds:.1f} s")
    print()
    return opened


def _seconds(details: list[dict[str, Any]]) -> str:
    stages: dict[str, list[float]] = {}
    for detail in details:
        for stage, value in detail["seconds"].items():
            stages.setdefault(stage, []).append(value)
    medians = (f"{stage} {np.median(values):.2f}" for stage, values in stages.items())
    return "seconds a query (median): " + ", ".join(medians)


if __name__ == "__main__":
    sys.exit(main())
