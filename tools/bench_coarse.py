#!/usr/bin/env python3
"""Compares matchers in the coarse stage on the RedKitchen queries of $GSCPE_DATA.

For each matcher, over the queries: matches that could be lifted, those within 1 and 3 pixels at
the true pose, and seconds by step, in the first round (from the reference pose) and the last; the
pose error after either. Then, if asked for, how often the whole pipeline finds the pose without
every third reference photo, and with the best one replaced by a random one.

Usage: .venv/bin/python tools/bench_coarse.py [MAP] [--queries N] [--matchers NAME ...]
           [--thin-references] [--random-reference] [--backend NAME]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, Sequence, cast

import numpy as np

from gscpe import Camera, LocalizationResult, Localizer, LocalizerSettings, open_map, read_image
from gscpe.arrays import BoolArray, Float64Array, UInt8Array
from gscpe.coarse import CoarseSettings, estimate_coarse_pose
from gscpe.coarse.lift import lift
from gscpe.errors import ModelError
from gscpe.geometry.pose_error import PoseDifference, pose_difference
from gscpe.geometry.projection import project, transform_points
from gscpe.mapping import build_map
from gscpe.matching import (
    LighterGlueMatcher,
    LighterGlueMatcherSettings,
    Matcher,
    Matches,
    PolishSettings,
    SiftMatcher,
    SiftMatcherSettings,
    XFeatMatcher,
    XFeatMatcherSettings,
)
from gscpe.render import RenderedView, Renderer
from gscpe.retrieval import RetrievedReference, open_describer, search
from gscpe.scene import Map, References, read_splat, to_photo
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.poses.hloc import read_poses
from gscpe.scene.query_list import Query, read_query_list

MATCHERS: dict[str, Callable[[], Matcher]] = {
    "sift": lambda: SiftMatcher(SiftMatcherSettings(polish=None)),
    "sift, polished": lambda: SiftMatcher(SiftMatcherSettings(polish=PolishSettings())),
    "xfeat": lambda: XFeatMatcher(XFeatMatcherSettings(polish=None)),
    "xfeat, polished": XFeatMatcher,
    "xfeat+lighterglue": lambda: LighterGlueMatcher(LighterGlueMatcherSettings(polish=None)),
    "xfeat+lighterglue, polished": LighterGlueMatcher,
}
THRESHOLDS = ((0.01, 1.0), (0.05, 5.0))


@dataclass
class Round:
    """What happened in one round of the coarse loop; seconds by step."""

    view: RenderedView
    seconds: dict[str, float]
    matches: Matches | None = None
    end: float = 0.0
    near: tuple[int, int] = (0, 0)
    lifted: int = 0


@dataclass
class Run:
    """One query."""

    prepare_photo: float
    rounds: list[Round]
    errors: list[PoseDifference] = field(default_factory=list)


class Recorder:
    """Stands for renderer and matcher, and keeps time; lift and PnP are what lies between."""

    def __init__(self, renderer: Renderer, matcher: Matcher) -> None:
        self._renderer, self._matcher = renderer, matcher
        self.rounds: list[Round] = []

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        begin = self.finish_round()
        view = self._renderer.render(camera, cam_from_world)
        self.rounds.append(Round(view, {"render": time.perf_counter() - begin}))
        return view

    def prepare(self, rgb: UInt8Array, valid: BoolArray | None) -> Any:
        begin = time.perf_counter()
        prepared = self._matcher.prepare(rgb, valid)
        self.rounds[-1].seconds["prepare render"] = time.perf_counter() - begin
        return prepared

    def match(self, photo: Any, render: Any) -> Matches:
        begin = time.perf_counter()
        matches = self._matcher.match(photo, render)
        last = self.rounds[-1]
        last.matches, last.end = matches, time.perf_counter()
        last.seconds["match"] = last.end - begin
        return matches

    def finish_round(self) -> float:
        now = time.perf_counter()
        if self.rounds:
            self.rounds[-1].seconds["lift and PnP"] = now - self.rounds[-1].end
        return now


class RandomFirst(Localizer):
    """Starts from a random reference photo instead of the one that retrieval found first."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._random = np.random.default_rng(0)  # the same references for every matcher

    def _retrieve(self, query: Any) -> tuple[RetrievedReference, ...]:
        chosen = int(self._random.integers(len(self.map.references)))
        return (RetrievedReference(chosen, 0.0), *super()._retrieve(query)[1:])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", nargs="?", help="of RedKitchen; built anew if not given")
    parser.add_argument("--queries", type=int, default=25, help="so many, evenly spaced")
    parser.add_argument("--matchers", nargs="+", choices=MATCHERS, default=list(MATCHERS))
    parser.add_argument("--backend", default="auto", choices=("auto", "gl", "cpu"))
    parser.add_argument("--thin-references", action="store_true", help="every third removed")
    parser.add_argument("--random-reference", action="store_true", help="in place of the best")
    options = parser.parse_args()
    data = Path(os.environ.get("GSCPE_DATA", "")) / "redkitchen"
    if not data.is_dir():
        print("set GSCPE_DATA to the folder that holds redkitchen/", file=sys.stderr)
        return 2
    map_ = open_map(options.map) if options.map else _build(data)
    truth = read_poses(data / "truth.txt")
    listed = read_query_list(data / "queries.txt")
    queries = [listed[i] for i in np.linspace(0, len(listed) - 1, options.queries).astype(int)]
    photos = [(query, read_image(data / "queries" / query.name)) for query in queries]
    matchers = {name: matcher for name in options.matchers if (matcher := _opened(name))}
    with Localizer(map_, matcher="sift", backend=options.backend) as localizer:
        print(f"{len(queries)} queries, {localizer.renderer_description}, {os.cpu_count()} cores")
        _print_coarse(
            {
                name: [_run(localizer, matcher, q, image, truth[q.name]) for q, image in photos]
                for name, matcher in matchers.items()
            }
        )
    if options.thin_references:
        thin = _thinned(map_)
        print(f"\nReferences: {len(thin.references)} of {len(map_.references)}\n")
        _print_recovery(Localizer, thin, matchers, photos, truth, options.backend)
    if options.random_reference:
        print("\nFirst reference: a random one\n")
        _print_recovery(RandomFirst, map_, matchers, photos, truth, options.backend)
    return 0


def _build(data: Path) -> Map:
    references = read_colmap_references(data / "sparse" / "0", data / "references")
    return build_map(read_splat(data / "splat.ply"), references, data / "references", progress=True)


def _opened(name: str) -> Matcher | None:
    try:
        return MATCHERS[name]()
    except ModelError as error:
        print(f"{name} is left out: {error}", file=sys.stderr)
        return None


def _run(
    localizer: Localizer, matcher: Matcher, query: Query, image: UInt8Array, truth: Float64Array
) -> Run:
    """The coarse loop from the best reference of one query."""
    photo = localizer.at_the_maps_resolution(to_photo(image, query.camera))
    known = localizer.map.descriptors
    described = open_describer(known).describe(photo.rgb, None, photo.valid)
    reference = search(described, known.descriptors, 1)[0]
    begin = time.perf_counter()
    prepared = matcher.prepare(photo.rgb, photo.valid)
    seconds = time.perf_counter() - begin
    recorder = Recorder(localizer._renderer, matcher)
    settings: CoarseSettings = localizer.settings.coarse
    result = estimate_coarse_pose(
        cast(Renderer, recorder),
        recorder,
        prepared,
        photo.camera,
        localizer.map.references.cam_from_world[reference.index],
        settings,
        localizer.map.metres_per_unit,
    )
    recorder.finish_round()
    for each in recorder.rounds:
        _count(each, photo.camera, truth, settings.min_opacity)
    run = Run(seconds, recorder.rounds)
    # A round renders at the pose that the one before it found.
    found = [each.view.cam_from_world for each in recorder.rounds[1:]]
    poses = (*found, result.cam_from_world)
    run.errors = [
        pose_difference(pose, truth) if pose is not None else PoseDifference(np.inf, 180.0)
        for pose in poses
    ]
    return run


def _count(each: Round, camera: Camera, truth: Float64Array, min_opacity: float) -> None:
    """Matches that can be lifted, and how many of them lie near the true projection."""
    if each.matches is None or not len(each.matches):
        return
    points, liftable = lift(each.view, each.matches.render_pixels, min_opacity)
    points_in_cam = transform_points(truth, points[liftable])
    ahead = points_in_cam[:, 2] > 0
    pixels = each.matches.photo_pixels[liftable][ahead]
    errors = np.linalg.norm(project(camera, points_in_cam[ahead]) - pixels, axis=1)
    each.lifted = int(liftable.sum())
    each.near = (int((errors < 1.0).sum()), int((errors < 3.0).sum()))


def _print_coarse(runs: dict[str, list[Run]]) -> None:
    shares = " | ".join(f"{100 * m:.0f} cm/{d:.0f}°" for m, d in THRESHOLDS)
    print("\nMedians over the queries; in brackets the worst query.\n")
    print(f"| matcher | round | matches | within 1 px | within 3 px | pose error | {shares} |")
    print("|---|---|---|---|---|---|---|---|")
    for name, of_matcher in runs.items():
        for label, index in (("first", 0), ("last", -1)):
            rounds = [run.rounds[index] for run in of_matcher]
            counts = [
                [each.lifted for each in rounds],
                [each.near[0] for each in rounds],
                [each.near[1] for each in rounds],
            ]
            cells = " | ".join(f"{np.median(c):.0f} ({min(c)})" for c in counts)
            errors = [run.errors[index] for run in of_matcher]
            print(f"| {name} | {label} | {cells} | {_error(errors)} | {_shares(errors)} |")
    print()
    steps = ("render", "prepare render", "match", "lift and PnP")
    print(f"| matcher, seconds | prepare photo | round | {' | '.join(steps)} | rounds |")
    print("|---|---|---|" + "---|" * (len(steps) + 1))
    for name, of_matcher in runs.items():
        photo = np.median([run.prepare_photo for run in of_matcher])
        number = np.mean([len(run.rounds) for run in of_matcher])
        for label, index in (("first", 0), ("last", -1)):
            cells = " | ".join(
                f"{np.median([run.rounds[index].seconds.get(s, 0.0) for run in of_matcher]):.3f}"
                for s in steps
            )
            print(f"| {name} | {photo:.3f} | {label} | {cells} | {number:.1f} |")


def _error(errors: Sequence[PoseDifference]) -> str:
    distances, degrees = ([getattr(e, a) for e in errors] for a in ("distance", "degrees"))
    return (
        f"{100 * np.median(distances):.3f} cm / {np.median(degrees):.3f}° "
        f"({100 * max(distances):.2f} cm)"
    )


def _shares(errors: Sequence[PoseDifference]) -> str:
    shares = [
        np.mean([e.distance <= metres and e.degrees <= degrees for e in errors])
        for metres, degrees in THRESHOLDS
    ]
    return " | ".join(f"{100 * share:.0f}%" for share in shares)


def _thinned(map_: Map) -> Map:
    """Without every third reference photo."""
    kept = np.flatnonzero(np.arange(len(map_.references)) % 3 != 1)
    references = map_.references
    return replace(
        map_,
        references=References(
            tuple(references.names[i] for i in kept),
            references.cam_from_world[kept],
            tuple(references.cameras[i] for i in kept),
        ),
        descriptors=replace(map_.descriptors, descriptors=map_.descriptors.descriptors[kept]),
    )


def _print_recovery(
    kind: type[Localizer],
    map_: Map,
    matchers: dict[str, Matcher],
    photos: Sequence[tuple[Query, UInt8Array]],
    truth: dict[str, Float64Array],
    backend: str,
) -> None:
    """Of the whole pipeline with one hypothesis, and with as many as it tries by default."""
    print("| matcher | hypotheses | localized | coarse 5 cm/5° | final 5 cm/5° |")
    print("|---|---|---|---|---|")
    default = LocalizerSettings()
    for hypotheses in (1, default.hypotheses):
        for name, matcher in matchers.items():
            settings = replace(default, hypotheses=hypotheses)
            with kind(map_, settings, matcher, backend) as localizer:
                results = [
                    (localizer.localize(image, query.camera), truth[query.name])
                    for query, image in photos
                ]
            coarse = np.mean([_near(_coarse_pose(result), pose) for result, pose in results])
            final = np.mean([_near(result.cam_from_world, pose) for result, pose in results])
            localized = sum(result.localized for result, _ in results)
            print(
                f"| {name} | {hypotheses} | {localized} of {len(results)} | "
                f"{100 * coarse:.0f}% | {100 * final:.0f}% |",
                flush=True,
            )


def _coarse_pose(result: LocalizationResult) -> Float64Array | None:
    return result.coarse.cam_from_world if result.coarse else None


def _near(pose: Float64Array | None, truth: Float64Array) -> bool:
    if pose is None:
        return False
    error = pose_difference(pose, truth)
    return error.distance <= 0.05 and error.degrees <= 5.0


if __name__ == "__main__":
    sys.exit(main())
