# SPDX-License-Identifier: Apache-2.0
"""What easy photos gain: with the whole coarse loop and without, RedKitchen's queries in turns, in
seconds and as multiples of a render of the same photos.

On a busy machine the seconds are of no use, and the processor seconds say what there is to do.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, field
from typing import Callable, Sequence, TypeVar

import numpy as np
from _common import Case, error_of, median_error, progress, read_cases, redkitchen, table

from gscpe import EasySettings, LocalizationResult, Localizer, LocalizerSettings, open_map
from gscpe.coarse import AbsolutePose
from gscpe.cores import available_cores
from gscpe.localization import Observer
from gscpe.matching import Matches
from gscpe.render import RenderedView

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


class Rounds(Observer):
    """Widths of the renders that were matched, of the photo at hand."""

    def __init__(self) -> None:
        self.widths: list[int] = []

    def round_done(
        self, view: RenderedView, matches: Matches, estimate: AbsolutePose | None
    ) -> None:
        self.widths.append(view.camera.width)

    @property
    def were_easy(self) -> bool:
        """A small render and one of full size, and no other."""
        return len(self.widths) == 2 and self.widths[0] < self.widths[1]


@dataclass
class Way:
    """One way to localize, and what came of it.

    Attributes:
        localizer: that does it.
        clock: of its calls.
        results: one for each query.
        easy: photos that were done with two renders.
    """

    localizer: Localizer
    clock: Clocked = field(default_factory=Clocked)
    results: list[LocalizationResult] = field(default_factory=list)
    easy: int = 0

    def localize(self, case: Case) -> None:
        camera, rounds = case.query.camera, Rounds()
        result = self.clock.of(lambda: self.localizer.localize(case.image, camera, observer=rounds))
        self.results.append(result)
        self.easy += rounds.were_easy


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", help="of RedKitchen")
    parser.add_argument("--queries", type=int, default=100)
    parser.add_argument("--backend", default="auto")
    options = parser.parse_args()
    map_, cases = open_map(options.map), read_cases(redkitchen(), options.queries)
    ways = {
        name: Way(Localizer(map_, LocalizerSettings(easy=easy), backend=options.backend))
        for name, easy in (("whole loop", EasySettings(side=0)), ("easy photos", EasySettings()))
    }
    renders = Clocked()
    for way in ways.values():
        way.localizer.localize(cases[0].image, cases[0].query.camera)  # makes what is made once
    for case in progress(cases, "queries"):
        for way in ways.values():
            way.localize(case)
            renders.of(_rendering(way.localizer, case))
    description = ways["whole loop"].localizer.renderer_description
    print(f"{len(cases)} queries, {available_cores()} cores, {description}.")
    print(
        f"A render of the same photos: {np.median(renders.seconds):.3f} s, "
        f"{np.median(renders.processor):.3f} s of processor time.\n"
    )
    table(
        ["", "localized", "with two renders", "final, median", "rms", "coarse, median", "seconds",
         "renders", "processor seconds", "renders"],
        (_row(name, cases, way, renders) for name, way in ways.items()),
    )  # fmt: skip
    for way in ways.values():
        way.localizer.close()
    return 0


def _rendering(localizer: Localizer, case: Case) -> Callable[[], object]:
    camera = case.photo_in(localizer).camera
    return lambda: localizer.render(camera, case.truth)


def _row(name: str, cases: Sequence[Case], way: Way, renders: Clocked) -> list[str]:
    pairs = list(zip(way.results, cases, strict=True))
    final = [error_of(result.cam_from_world, case.truth) for result, case in pairs]
    coarse = [
        error_of(result.coarse.cam_from_world if result.coarse else None, case.truth)
        for result, case in pairs
    ]
    found = np.array([error.centimetres for error in final if np.isfinite(error.centimetres)])
    seconds, processor = np.median(way.clock.seconds), np.median(way.clock.processor)
    return [
        name,
        f"{len(found)} of {len(cases)}",
        str(way.easy),
        median_error(final),
        f"{np.sqrt(np.mean(found**2)):.3f} cm",
        median_error(coarse),
        f"{seconds:.3f}",
        f"{seconds / np.median(renders.seconds):.1f}",
        f"{processor:.3f}",
        f"{processor / np.median(renders.processor):.1f}",
    ]


if __name__ == "__main__":
    sys.exit(main())
