#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares global descriptors on RedKitchen ($GSCPE_DATA).

Every query and reference photo is looked for among the references that are more than --gap
frames away from it in the sequence, so that none is nearly the same photo. The references are
described by their photos, by renders of the splat from their poses, and by these renders
blurred and darkened. A reference overlaps by the share of the query's pixels that it sees: they
are lifted with the rendered depth, and must land in the reference at the depth rendered there,
to 5%. VLAD depends on the vocabulary that k-means happens to find, so each number is a mean over
--seeds vocabularies, with the least and greatest.

With --every, so many references are left out, and only photos are compared: "1 3 10" means all
of them, every third and every tenth. VLAD's words are then learned from those that are left.

Usage: .venv/bin/python tools/bench_retrieval.py [--gap FRAMES] [--seeds N] [--onnx PATH]
           [--every 1 3 10]
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Callable, Iterator, Sequence

import cv2
import numpy as np
from _common import progress, read_cases, redkitchen, table

from gscpe.arrays import BoolArray, Float32Array, Float64Array, UInt8Array
from gscpe.errors import ModelError
from gscpe.features import XFeat
from gscpe.geometry import Camera, pose_difference
from gscpe.geometry.projection import pixel_centres, transform_points, unproject
from gscpe.geometry.se3 import inverse
from gscpe.photos import read_image, to_uint8
from gscpe.render import Renderer
from gscpe.retrieval import (
    OnnxDescriber,
    VocabularySettings,
    aggregate,
    learn_vocabulary,
    rootsift,
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


@dataclass(frozen=True, eq=False)
class Answers:
    """What a good answer is: (queries, references) each.

    Attributes:
        near: whether the reference's pose is near the query's.
        overlap: the share of the query's pixels that the reference sees.
        allowed: whether they are far enough from each other in the sequence.
    """

    near: BoolArray
    overlap: Float64Array
    allowed: BoolArray

    def among(self, kept: slice) -> Answers:
        """Of some of the references."""
        return Answers(self.near[:, kept], self.overlap[:, kept], self.allowed[:, kept])

    def good(self) -> tuple[BoolArray, BoolArray]:
        return self.near, self.overlap >= OVERLAP


@dataclass(frozen=True, eq=False)
class Database:
    """Images that are searched: some of the reference photos, or others of the same places."""

    label: str
    kept: slice
    images: Sequence[UInt8Array] | None = None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--gap", type=int, default=100, help="frames, default: %(default)s")
    parser.add_argument("--seeds", type=int, default=5, help="default: %(default)s")
    parser.add_argument("--queries", type=int, default=100, help="so many, evenly spaced")
    parser.add_argument("--onnx", metavar="PATH", help="an exported network, too")
    parser.add_argument("--every", nargs="+", type=int, metavar="N", help="of the references")
    options = parser.parse_args()
    found = methods(options.onnx, counts=() if options.every else (500, 2048))
    bench(redkitchen(), found, options)
    return 0


def methods(onnx: str | None, counts: Sequence[int]) -> list[Method]:
    """VLAD, and what is installed: VLAD of XFeat, also of so many of its features."""
    found = [Method("vlad (RootSIFT, 320)", rootsift, 64)]
    try:
        network = XFeat()
        found.append(Method("vlad-xfeat (full size)", xfeat(network), 128))
        for count in counts:
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


def bench(data: Path, found: Sequence[Method], options: argparse.Namespace) -> None:
    references = read_colmap_references(data / "sparse" / "0", data / "references")
    photos = [read_image(data / "references" / name) for name in references.names]
    cases = read_cases(data, options.queries) if options.queries else []
    asked = [*photos, *(case.image for case in cases)]
    names = [*references.names, *(case.query.name for case in cases)]
    poses = [*references.cam_from_world, *(case.truth for case in cases)]
    cameras = [*references.cameras, *(case.query.camera for case in cases)]
    whole = slice(0, len(photos))
    with Renderer(read_splat(data / "splat.ply")) as renderer:
        depths = [
            renderer.render(camera.resized(*GRID), pose).depth
            for camera, pose in zip(cameras, poses, strict=True)
        ]
        if options.every:
            kept = [slice(0, len(photos), every) for every in options.every]
            databases = [Database(f"{len(photos[each])} photos", each) for each in kept]
        else:
            renders = [
                to_uint8(renderer.render(camera, pose).rgb)
                for camera, pose in zip(references.cameras, references.cam_from_world, strict=True)
            ]
            worse = [degraded(image) for image in renders]
            databases = [
                Database("photos", whole),
                Database("renders", whole, renders),
                Database("degraded renders", whole, worse),
            ]
    frames = np.array([int(re.findall(r"\d+", name)[0]) for name in names])
    answers = Answers(
        nearness(poses, len(photos)),
        overlaps(poses, cameras, depths, len(photos)),
        np.abs(frames[:, None] - frames[whole]) > options.gap,
    )
    have = [float((good & answers.allowed).any(axis=1).mean()) for good in answers.good()]
    print(
        f"{len(asked)} queries, {len(photos)} references, those within {options.gap} frames "
        f"excluded; {options.seeds} vocabularies\n"
        f"{have[0]:.0%} of the queries have a reference within {NEAR:g} m/{NEAR_DEGREES:g}°, "
        f"{have[1]:.0%} one that sees {OVERLAP:.0%} of them; only these count in the columns\n"
    )
    table(
        ["references are", "method", f"{NEAR:g} m/{NEAR_DEGREES:g}°: top 1", "of top 3",
         f"sees {OVERLAP:.0%}: top 1", "of top 3", "overlap of top 1, of the possible",
         "ms a photo"],
        rows(found, asked, databases, answers, options.seeds),
    )  # fmt: skip


def rows(
    found: Sequence[Method],
    asked: Sequence[UInt8Array],
    databases: Sequence[Database],
    answers: Answers,
    seeds: int,
) -> Iterator[list[str]]:
    """Each photo is described once by each method, whatever is left out."""
    for method in found:
        begin = time.perf_counter()
        local_queries = [method.extract(image) for image in progress(asked, method.name)]
        milliseconds = f"{1000 * (time.perf_counter() - begin) / len(asked):.0f}"
        for database in databases:
            if database.images is None:
                local = local_queries[database.kept]
            else:
                local = [method.extract(image) for image in database.images]
            judged = answers.among(database.kept)
            of_seed = [
                shares(method, seed, local, local_queries, judged)
                for seed in range(seeds if method.words else 1)
            ]
            cells = (
                f"{np.mean(column):.2f} ({min(column):.2f} to {max(column):.2f})"
                if len(column) > 1
                else f"{column[0]:.2f}"
                for column in zip(*of_seed, strict=True)
            )
            yield [database.label, method.name, *cells, milliseconds]


def shares(
    method: Method,
    seed: int,
    local: Sequence[Float32Array],
    local_queries: Sequence[Float32Array],
    answers: Answers,
) -> list[float]:
    """The columns of one row."""
    if method.words is None:
        database, queries = np.concatenate(local), np.concatenate(local_queries)
    else:
        vocabulary = learn_vocabulary(local, VocabularySettings(method.words), seed)
        database = np.stack([aggregate(each, vocabulary) for each in local])
        queries = np.stack([aggregate(each, vocabulary) for each in local_queries])
    similarity = np.where(answers.allowed, queries @ database.T, -np.inf)
    best = np.argsort(-similarity, axis=1, kind="stable")[:, :3]
    row = []
    for good in answers.good():
        possible = (good & answers.allowed).any(axis=1)
        hits = np.take_along_axis(good & answers.allowed, best, axis=1)[possible]
        row += [float(hits[:, 0].mean()), float(hits.any(axis=1).mean())]
    reached = np.take_along_axis(answers.overlap, best, axis=1)[:, 0]
    most = np.where(answers.allowed, answers.overlap, 0).max(axis=1)
    return [*row, float(reached.sum() / most.sum())]


def nearness(poses: Sequence[Float64Array], references: int) -> BoolArray:
    """(queries, references): whether the reference's pose is near the query's."""
    differences = [[pose_difference(a, b) for b in poses[:references]] for a in poses]
    return np.array(
        [[d.distance < NEAR and d.degrees < NEAR_DEGREES for d in row] for row in differences]
    )


def overlaps(
    poses: Sequence[Float64Array],
    cameras: Sequence[Camera],
    depths: Sequence[Float32Array],
    references: int,
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


if __name__ == "__main__":
    sys.exit(main())
