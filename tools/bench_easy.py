# SPDX-License-Identifier: Apache-2.0
"""What an easy photo costs: the whole coarse loop and the form for easy photos on RedKitchen's
queries, photo by photo in turns, in seconds and as multiples of a render of the same photos."""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass, field
from typing import Callable, Sequence, TypeVar

import numpy as np
from _common import Case, error_of, median_error, progress, read_cases, redkitchen, table

from gscpe import EasySettings, LocalizationResult, Localizer, LocalizerSettings, open_map

_T = TypeVar("_T")


@dataclass
class Clocked:
    """Times of one thing that was done again and again.

    Attributes:
        seconds, processor: of each time; processor time is that of all threads.
    """

    seconds: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)

    def of(self, work: Callable[[], _T]) -> _T:
        began, processor = time.perf_counter(), time.process_time()
        result = work()
        self.processor.append(time.process_time() - processor)
        self.seconds.append(time.perf_counter() - began)
        return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", help="of RedKitchen")
    parser.add_argument("--queries", type=int, default=100)
    parser.add_argument("--backend", default="auto")
    options = parser.parse_args()
    map_, cases = open_map(options.map), read_cases(redkitchen(), options.queries)
    easy = LocalizerSettings().easy
    sides = {"whole loop": 0, "easy photos": easy.side or 240}
    localizers = {
        name: Localizer(
            map_, LocalizerSettings(easy=EasySettings(side=side)), backend=options.backend
        )
        for name, side in sides.items()
    }
    clocks = {name: Clocked() for name in localizers}
    results: dict[str, list[LocalizationResult]] = {name: [] for name in localizers}
    renders = Clocked()
    for localizer in localizers.values():
        localizer.localize(cases[0].image, cases[0].query.camera)  # what is made once
    for case in progress(cases, "queries"):
        for name, localizer in localizers.items():
            work = _localizing(localizer, case)
            results[name].append(clocks[name].of(work))
            renders.of(_rendering(localizer, case))
    print(f"{len(cases)} queries, {os.cpu_count()} cores, {localizer.renderer_description}.")
    print(
        f"A render of the same photos: {np.median(renders.seconds):.3f} s, "
        f"{np.median(renders.processor):.3f} s of processor time.\n"
    )
    table(
        ["", "localized", "with two renders", "final, median", "rms", "coarse, median", "seconds",
         "renders", "processor seconds"],
        (_row(name, cases, results[name], clocks[name], renders) for name in localizers),
    )  # fmt: skip
    for localizer in localizers.values():
        localizer.close()
    return 0


def _localizing(localizer: Localizer, case: Case) -> Callable[[], LocalizationResult]:
    return lambda: localizer.localize(case.image, case.query.camera)


def _rendering(localizer: Localizer, case: Case) -> Callable[[], object]:
    camera = case.photo_in(localizer).camera
    return lambda: localizer.render(camera, case.truth)


def _row(
    name: str,
    cases: Sequence[Case],
    results: Sequence[LocalizationResult],
    clock: Clocked,
    renders: Clocked,
) -> list[str]:
    final = [error_of(r.cam_from_world, c.truth) for r, c in zip(results, cases, strict=True)]
    coarse = [
        error_of(r.coarse.cam_from_world if r.coarse else None, c.truth)
        for r, c in zip(results, cases, strict=True)
    ]
    found = np.array([error.centimetres for error in final if np.isfinite(error.centimetres)])
    easy = sum(a.easy for r in results for a in r.attempts[-1:])
    seconds = float(np.median(clock.seconds))
    return [
        name,
        f"{sum(r.localized for r in results)} of {len(results)}",
        str(easy),
        median_error(final),
        f"{np.sqrt(np.mean(found**2)):.3f} cm",
        median_error(coarse),
        f"{seconds:.3f}",
        f"{seconds / np.median(renders.seconds):.1f}",
        f"{np.median(clock.processor):.3f}",
    ]


if __name__ == "__main__":
    sys.exit(main())
