#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares global descriptors on RedKitchen ($GSCPE_DATA), and times the search of many.

Every query and reference photo is looked for among the references that are more than --gap
frames away from it in the sequence, so that none is nearly the same photo. The references are
described by their photos, by renders of the splat from their poses, and by these renders
blurred and darkened. A reference overlaps by the share of the query's pixels that it sees: they
are lifted with the rendered depth, and must land in the reference at the depth rendered there,
to 5%. VLAD depends on the vocabulary that k-means happens to find, so each number is a mean over
--seeds vocabularies, with the least and greatest.

With --every, so many references are left out, and only photos are compared: "1 3 10" means all
of them, every third and every tenth.

Usage: .venv/bin/python tools/bench_retrieval.py [--gap FRAMES] [--seeds N] [--onnx PATH]
           [--every 1 3 10]
       .venv/bin/python tools/bench_retrieval.py --index COUNT [--dimension D] [--probes N]
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Callable, Iterator

import cv2
import numpy as np
from _common import peak_bytes, read_cases, redkitchen, table

from gscpe.arrays import BoolArray, Float32Array, Float64Array, UInt8Array
from gscpe.errors import ModelError
from gscpe.features import XFeat
from gscpe.geometry import Camera, pose_difference
from gscpe.geometry.projection import pixel_centres, transform_points, unproject
from gscpe.geometry.se3 import inverse
from gscpe.photos import read_image, to_uint8
from gscpe.render import Renderer
from gscpe.retrieval import (
    IndexSettings,
    OnnxDescriber,
    ReferenceIndex,
    RetrievedReference,
    VocabularySettings,
    aggregate,
    learn_vocabulary,
    rootsift,
    search,
    xfeat,
)
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.splats import read_splat

NEAR, NEAR_DEGREES, OVERLAP = 1.0, 30.0, 0.5
GRID = (64, 48)


@dataclass(frozen=True)
class Method:
    """Local descriptors of an image, or, without words, its global descriptor (1, D)."""

    name: str
    extract: Callable[[UInt8Array], Float32Array]
    words: int | None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--gap", type=int, default=100, help="frames, default: %(default)s")
    parser.add_argument("--seeds", type=int, default=5, help="default: %(default)s")
    parser.add_argument("--queries", type=int, default=100, help="so many, evenly spaced")
    parser.add_argument("--onnx", metavar="PATH", help="an exported network, too")
    parser.add_argument("--every", nargs="+", type=int, metavar="N", help="of the references")
    parser.add_argument("--index", type=float, metavar="COUNT", help="time the search of as many")
    parser.add_argument("--dimension", type=int, default=512, help="of them")
    parser.add_argument("--probes", type=int, default=IndexSettings.probes, help="of the index")
    options = parser.parse_args()
    if options.index:
        bench_index(int(options.index), options.dimension, options.probes)
        return 0
    found = methods(options.onnx)
    if options.every:
        found = [method for method in found if "features" not in method.name]
    bench_redkitchen(redkitchen(), found, options)
    return 0


def methods(onnx: str | None) -> list[Method]:
    found = [Method("vlad (RootSIFT, 320)", rootsift, 64)]
    try:
        network = XFeat()
        found.append(Method("vlad-xfeat (full size)", xfeat(network), 128))
        for count in (500, 2048):
            name = f"vlad-xfeat, {count} features"
            found.append(Method(name, partial(best_xfeats, network, count), 128))
    except ModelError as error:
        print(error, file=sys.stderr)
    if onnx:
        describe = OnnxDescriber(onnx).describe
        found.append(Method(Path(onnx).name, lambda rgb: describe(rgb)[None], None))
    return found


def best_xfeats(network: XFeat, count: int, rgb: UInt8Array) -> Float32Array:
    return network.detect(rgb, count).descriptors


def degraded(rgb: UInt8Array) -> UInt8Array:
    return np.asarray(0.8 * cv2.GaussianBlur(rgb, (0, 0), 1.5), dtype=np.uint8)


def bench_redkitchen(data: Path, found: list[Method], options: argparse.Namespace) -> None:
    references = read_colmap_references(data / "sparse" / "0", data / "references")
    photos = [read_image(data / "references" / name) for name in references.names]
    cases = read_cases(data, options.queries) if options.queries else []
    asked = [*photos, *(case.image for case in cases)]
    names = [*references.names, *(case.query.name for case in cases)]
    poses = [*references.cam_from_world, *(case.truth for case in cases)]
    cameras = [*references.cameras, *(case.query.camera for case in cases)]
    with Renderer(read_splat(data / "splat.ply")) as renderer:
        depths = [
            renderer.render(camera.resized(*GRID), pose).depth
            for camera, pose in zip(cameras, poses, strict=True)
        ]
        renders = (
            []
            if options.every
            else [
                to_uint8(renderer.render(camera, pose).rgb)
                for camera, pose in zip(references.cameras, references.cam_from_world, strict=True)
            ]
        )
    overlap = overlaps(poses, cameras, depths, len(photos))
    near = nearness(poses, len(photos))
    frames = np.array([int(re.findall(r"\d+", name)[0]) for name in names])
    allowed = np.abs(frames[:, None] - frames[: len(photos)]) > options.gap
    have = [float((good & allowed).any(axis=1).mean()) for good in (near, overlap >= OVERLAP)]
    print(
        f"{len(asked)} queries, {len(photos)} references, those within {options.gap} frames "
        f"excluded; {options.seeds} vocabularies\n"
        f"{have[0]:.0%} of the queries have a reference within {NEAR:g} m/{NEAR_DEGREES:g}°, "
        f"{have[1]:.0%} one that sees {OVERLAP:.0%} of them; only these count in the columns\n"
    )
    if options.every:
        bench_few(found, options, photos, asked, near, overlap, allowed)
        return
    kinds = {
        "photos": photos,
        "renders": renders,
        "degraded renders": [degraded(image) for image in renders],
    }

    def rows() -> Iterator[list[str]]:
        for method in found:
            begin = time.perf_counter()
            local_queries = [method.extract(image) for image in asked]
            milliseconds = f"{1000 * (time.perf_counter() - begin) / len(asked):.0f}"
            for kind, database in kinds.items():
                local = [method.extract(image) for image in database]
                of_seed = [
                    shares(method, seed, local, local_queries, near, overlap, allowed)
                    for seed in range(options.seeds if method.words else 1)
                ]
                cells = (
                    f"{np.mean(column):.2f} ({min(column):.2f} to {max(column):.2f})"
                    for column in zip(*of_seed, strict=True)
                )
                yield [kind, method.name, *cells, milliseconds]

    table(
        ["references are", "method", f"{NEAR:g} m/{NEAR_DEGREES:g}°: top 1", "of top 3",
         f"sees {OVERLAP:.0%}: top 1", "of top 3", "overlap of top 1, of the possible",
         "ms a photo"],
        rows(),
    )  # fmt: skip


def bench_few(
    found: list[Method],
    options: argparse.Namespace,
    photos: list[UInt8Array],
    asked: list[UInt8Array],
    near: BoolArray,
    overlap: Float64Array,
    allowed: BoolArray,
) -> None:
    """The table for --every; photos come first among those that are asked for."""

    def rows() -> Iterator[list[str]]:
        for method in found:
            local = [method.extract(image) for image in asked]
            for every in options.every:
                kept = slice(0, len(photos), every)
                of_seed = [
                    shares(
                        *(method, seed, local[kept], local),
                        *(near[:, kept], overlap[:, kept], allowed[:, kept]),
                    )
                    for seed in range(options.seeds if method.words else 1)
                ]
                columns = [f"{np.mean(column):.2f}" for column in zip(*of_seed, strict=True)]
                yield [method.name, str(len(photos[kept])), *columns]

    table(
        ["method", "references", f"{NEAR:g} m/{NEAR_DEGREES:g}°: top 1", "of top 3",
         f"sees {OVERLAP:.0%}: top 1", "of top 3", "overlap of top 1, of the possible"],
        rows(),
    )  # fmt: skip


def shares(
    method: Method,
    seed: int,
    local: list[Float32Array],
    local_queries: list[Float32Array],
    near: BoolArray,
    overlap: Float64Array,
    allowed: BoolArray,
) -> list[float]:
    """The columns of one row."""
    if method.words is None:
        database, queries = np.concatenate(local), np.concatenate(local_queries)
    else:
        vocabulary = learn_vocabulary(local, VocabularySettings(method.words), seed)
        database = np.stack([aggregate(each, vocabulary) for each in local])
        queries = np.stack([aggregate(each, vocabulary) for each in local_queries])
    similarity = np.where(allowed, queries @ database.T, -np.inf)
    best = np.argsort(-similarity, axis=1, kind="stable")[:, :3]
    row = []
    for good in (near, overlap >= OVERLAP):
        possible = (good & allowed).any(axis=1)
        hits = np.take_along_axis(good, best, axis=1)[possible]
        row += [float(hits[:, 0].mean()), float(hits.any(axis=1).mean())]
    reached = np.take_along_axis(overlap, best, axis=1)[:, 0]
    return [*row, float(reached.sum() / np.where(allowed, overlap, 0).max(axis=1).sum())]


def nearness(poses: list[Float64Array], references: int) -> BoolArray:
    """(queries, references): whether the reference's pose is near the query's."""
    differences = [[pose_difference(a, b) for b in poses[:references]] for a in poses]
    return np.array(
        [[d.distance < NEAR and d.degrees < NEAR_DEGREES for d in row] for row in differences]
    )


def overlaps(
    poses: list[Float64Array], cameras: list[Camera], depths: list[Float32Array], references: int
) -> Float64Array:
    """(queries, references): the share of the query's pixels that the reference sees."""
    result = np.zeros((len(poses), references))
    width, height = GRID
    for i, (pose, camera, depth) in enumerate(zip(poses, cameras, depths, strict=True)):
        small = camera.resized(*GRID)
        seen = depth > 0
        points = unproject(small, pixel_centres(small)[seen], depth[seen].astype(np.float64))
        points = transform_points(inverse(pose), points)
        for j in range(references):
            there, at = transform_points(poses[j], points), cameras[j].resized(*GRID)
            z = np.maximum(there[:, 2], 1e-9)
            u = np.floor(np.clip(at.fx * there[:, 0] / z + at.cx, -1, width)).astype(int)
            v = np.floor(np.clip(at.fy * there[:, 1] / z + at.cy, -1, height)).astype(int)
            inside = (there[:, 2] > 0.1) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
            expected = depths[j][v[inside], u[inside]]
            agrees = np.abs(expected - z[inside]) < 0.05 * z[inside]
            result[i, j] = np.count_nonzero(agrees) / depth.size
    return result


def bench_index(count: int, dimension: int, probes: int) -> None:
    """Synthetic places on a 32-dimensional surface with noise; queries 0.6 to 0.8 similar."""
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
