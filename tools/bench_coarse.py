#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares matchers on the RedKitchen queries of $GSCPE_DATA.

For each matcher, over the queries: matches that could be lifted, those within 1 and 3 pixels at
the true pose, and the pose error, of the first round of the coarse stage (from the reference
pose) and the last; seconds a query. Then, if asked for, how often the whole pipeline finds the
pose without every third reference photo, and with the best one replaced by a random one.

Usage: .venv/bin/python tools/bench_coarse.py MAP [--queries N] [--matchers NAME ...]
           [--thin-references] [--random-reference] [--backend NAME]
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass
from typing import Callable, Sequence

import numpy as np
from _common import (
    Case,
    Error,
    error_of,
    median_error,
    progress,
    read_cases,
    redkitchen,
    table,
    within,
)

from gscpe import EasySettings, LocalizationResult, Localizer, LocalizerSettings, open_map
from gscpe.arrays import Float64Array
from gscpe.coarse import AbsolutePose, lift
from gscpe.errors import ModelError
from gscpe.geometry.projection import project, transform_points
from gscpe.localization import Attempt, Observer
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
from gscpe.render import RenderedView
from gscpe.retrieval import open_describer, search
from gscpe.scene import Map

WHOLE_LOOP = LocalizerSettings(easy=EasySettings(side=0))
"""Easy photos would have one round of full size."""

MATCHERS: dict[str, Callable[[], Matcher]] = {
    "sift": lambda: SiftMatcher(SiftMatcherSettings(polish=None)),
    "sift, polished": lambda: SiftMatcher(SiftMatcherSettings(polish=PolishSettings())),
    "xfeat": lambda: XFeatMatcher(XFeatMatcherSettings(polish=None)),
    "xfeat, polished": XFeatMatcher,
    "xfeat+lighterglue": lambda: LighterGlueMatcher(LighterGlueMatcherSettings(polish=None)),
    "xfeat+lighterglue, polished": LighterGlueMatcher,
}


@dataclass(frozen=True)
class Round:
    """One round of the coarse stage: matches that could be lifted, those of them within 1 and 3
    pixels at the true pose, and the error of the pose that came of them."""

    lifted: int
    near: tuple[int, int]
    error: Error


class Rounds(Observer):
    """Keeps the rounds of the first place that is tried."""

    def __init__(self, case: Case, min_opacity: float) -> None:
        self.rounds: list[Round] = []
        self._case, self._min_opacity = case, min_opacity
        self._first = True

    def round_done(
        self, view: RenderedView, matches: Matches, estimate: AbsolutePose | None
    ) -> None:
        if not self._first:
            return
        points, liftable = lift(view, matches.render_pixels, self._min_opacity)
        in_cam = transform_points(self._case.truth, points[liftable])
        ahead = in_cam[:, 2] > 0
        expected, pixels = project(view.camera, in_cam[ahead]), matches.photo_pixels[liftable]
        apart = np.linalg.norm(expected - pixels[ahead], axis=1)
        self.rounds.append(
            Round(
                int(liftable.sum()),
                (int((apart < 1.0).sum()), int((apart < 3.0).sum())),
                error_of(None if estimate is None else estimate.cam_from_world, self._case.truth),
            )
        )

    def attempted(self, attempt: Attempt) -> None:
        self._first = False


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--queries", type=int, default=25, help="so many, evenly spaced")
    parser.add_argument("--matchers", nargs="+", choices=MATCHERS, default=list(MATCHERS))
    parser.add_argument("--backend", default="auto", choices=("auto", "gl", "cpu"))
    parser.add_argument("--thin-references", action="store_true", help="every third removed")
    parser.add_argument("--random-reference", action="store_true", help="in place of the best")
    options = parser.parse_args()
    map_, cases = open_map(options.map), read_cases(redkitchen(), options.queries)
    matchers = {name: matcher for name in options.matchers if (matcher := _opened(name))}
    print(f"{len(cases)} queries, {os.cpu_count()} cores. Medians; in brackets the worst query.\n")
    table(
        ["matcher", "round", "matches", "within 1 px", "within 3 px", "pose error", "1 cm/1°",
         "5 cm/5°", "s a query: features", "coarse"],
        (
            row
            for name, matcher in matchers.items()
            for row in _rounds(
                name, Localizer(map_, WHOLE_LOOP, matcher, options.backend), cases
            )
        ),
    )  # fmt: skip
    ranked = [_ranked(map_, case) for case in cases]
    if options.thin_references:
        kept = {name for i, name in enumerate(map_.references.names) if i % 3 != 1}
        print(f"\nWith {len(kept)} of {len(map_.references)} references:\n")
        thinned = [[name for name in names if name in kept] for names in ranked]
        _print_recovery(map_, matchers, cases, thinned, options.backend)
    if options.random_reference:
        print("\nWith a random reference in place of the best one:\n")
        drawn = np.random.default_rng(0).integers(len(map_.references), size=len(cases))
        names = map_.references.names
        misled = [[names[i], *others[1:]] for i, others in zip(drawn, ranked, strict=True)]
        _print_recovery(map_, matchers, cases, misled, options.backend)
    return 0


def _opened(name: str) -> Matcher | None:
    try:
        return MATCHERS[name]()
    except ModelError as error:
        print(f"{name} is left out: {error}", file=sys.stderr)
        return None


def _rounds(name: str, localizer: Localizer, cases: Sequence[Case]) -> list[list[str]]:
    """Rows of the first and of the last round."""
    rounds, results = [], []
    with localizer:
        for case in progress(cases, name):
            observer = Rounds(case, localizer.settings.coarse.min_opacity)
            results.append(localizer.localize(case.image, case.query.camera, observer=observer))
            rounds.append(observer.rounds)
    seconds = [
        f"{np.median([result.seconds.get(stage, 0.0) for result in results]):.3f}"
        for stage in ("features", "coarse")
    ]
    rows = []
    for label, index in (("first", 0), ("last", -1)):
        its = [of_query[index] for of_query in rounds if of_query]
        counts = [r.lifted for r in its], [r.near[0] for r in its], [r.near[1] for r in its]
        errors = [r.error for r in its]
        worst = max(error.centimetres for error in errors)
        rows.append(
            [name, label, *(f"{np.median(c):.0f} ({min(c)})" for c in counts),
             f"{median_error(errors)} ({worst:.2f} cm)", within(errors, 1.0, 1.0),
             within(errors, 5.0, 5.0), *seconds]
        )  # fmt: skip
    return rows


def _ranked(map_: Map, case: Case) -> list[str]:
    """The reference photos, most similar first."""
    known = map_.descriptors
    described = open_describer(known).describe(case.image)
    found = search(described, known.descriptors, len(known.descriptors))
    return [map_.references.names[reference.index] for reference in found]


def _print_recovery(
    map_: Map,
    matchers: dict[str, Matcher],
    cases: Sequence[Case],
    references: Sequence[Sequence[str]],
    backend: str,
) -> None:
    """Of the whole pipeline with one place, and with as many as it tries by default."""
    rows = []
    for name, matcher in matchers.items():
        with Localizer(map_, WHOLE_LOOP, matcher, backend) as localizer:
            settings = localizer.settings
            for places, most in ((1, 1), (settings.hypotheses, settings.retrieved)):
                results = [
                    localizer.localize(case.image, case.query.camera, references=names[:most])
                    for case, names in zip(progress(cases, name), references, strict=True)
                ]
                coarse, final = [], []
                for case, result in zip(cases, results, strict=True):
                    coarse.append(error_of(_coarse_pose(result), case.truth))
                    final.append(error_of(result.cam_from_world, case.truth))
                localized = sum(result.localized for result in results)
                rows.append(
                    [name, str(places), f"{localized} of {len(results)}", within(coarse, 5.0, 5.0),
                     within(final, 5.0, 5.0)]
                )  # fmt: skip
    table(["matcher", "places tried", "localized", "coarse 5 cm/5°", "final 5 cm/5°"], rows)


def _coarse_pose(result: LocalizationResult) -> Float64Array | None:
    return result.coarse.cam_from_world if result.coarse else None


if __name__ == "__main__":
    sys.exit(main())
