#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the tracker on RedKitchen's five clips of $GSCPE_DATA (docs/benchmarks.md).

Each clip has 20 frames in a row. The first frame of each is localized, and is not counted in the
frame times. Decoding is not counted either.

--basin       frames left out between two (1, 2, 5, 10, 20) against success
--robustness  frames replaced by black, blurred, foreign and half-covered ones, or some --kinds
--memory N    N frames, by repeating the clips there and back; prints the memory on the way

Usage: .venv/bin/python tools/bench_tracking.py MAP [--fast] [--plot FILE.png] [--backend NAME]
           [--clips N] [--basin | --robustness [--kinds KIND ...] | --memory N]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Sequence

import numpy as np
from _common import Error, error_of, new_figure, redkitchen, save_figure, table
from tracking_disturbed import ALL_KINDS, disturb

from gscpe import (
    Camera,
    Localizer,
    Tracker,
    TrackingResult,
    TrackingSettings,
    open_map,
    read_image,
)
from gscpe.arrays import Float64Array, UInt8Array
from gscpe.poses import read_pose_file
from gscpe.scene.query_list import read_query_list

CLIP = 20
SKIPPED = (1, 2, 5, 10, 20)
ACCURATE = Error(5.0, 2.0)
"""Centimetres and degrees within which a pose counts as found."""


@dataclass(frozen=True, eq=False)
class View:
    """A frame with its (4, 4) true pose."""

    image: UInt8Array
    camera: Camera
    truth: Float64Array


@dataclass(eq=False)
class Run:
    """What a tracker said of many frames."""

    results: list[TrackingResult] = field(default_factory=list)
    errors: list[Error] = field(default_factory=list)
    milliseconds: list[float] = field(default_factory=list)
    anchors: int = 0
    seconds: float = 0.0

    def count(self, status: str) -> int:
        return sum(result.status == status for result in self.results)

    @property
    def rate(self) -> float:
        """Frames a second, the first of each clip not counted."""
        return len(self.milliseconds) / self.seconds


def read_clips(data: Path) -> list[list[View]]:
    truth = read_pose_file(data / "truth.txt").poses
    views = [
        View(read_image(data / "queries" / query.name), query.camera, truth[query.name])
        for query in read_query_list(data / "queries.txt")
    ]
    return [views[i : i + CLIP] for i in range(0, len(views), CLIP)]


def follow(
    localizer: Localizer, clip: Sequence[View], settings: TrackingSettings, run: Run
) -> None:
    """Adds what a new tracker makes of a clip."""
    unit = localizer.map.metres_per_unit or 1.0
    with Tracker(localizer, settings) as tracker:
        first = tracker.track(clip[0].image, clip[0].camera)
        run.results.append(first)
        begin, age = time.perf_counter(), 0
        for view in clip[1:]:
            result = tracker.track(view.image, view.camera)
            run.results.append(result)
            run.milliseconds.append(result.milliseconds)
            if result.cam_from_world is not None:
                run.errors.append(error_of(result.cam_from_world, view.truth, unit))
            if result.anchor_age is not None:
                run.anchors += result.anchor_age < age + 1
                age = result.anchor_age
        run.seconds += time.perf_counter() - begin


def one_photo_rate(localizer: Localizer, clips: Sequence[Sequence[View]]) -> float:
    """Photos a second: two of each clip."""
    views = [view for clip in clips for view in (clip[5], clip[14])]
    begin = time.perf_counter()
    for view in views:
        localizer.localize(view.image, view.camera)
    return len(views) / (time.perf_counter() - begin)


def measure(localizer: Localizer, clips: list[list[View]], fast: bool, plot: Path | None) -> None:
    photos = one_photo_rate(localizer, clips)
    print(f"one-photo localization: {photos:.2f} photos a second\n")
    runs, rows = {}, []
    kinds = {
        "full size": TrackingSettings(wait=True),
        "half size": TrackingSettings.fast(wait=True),
    }
    for name, settings in kinds.items():
        if fast and settings.scale == 1.0:
            continue
        run = Run()
        for clip in clips:
            follow(localizer, clip, settings, run)
        runs[name] = run
        errors = np.array([[error.centimetres, error.degrees] for error in run.errors])
        median, worst = np.median(errors, axis=0), np.max(errors, axis=0)
        times = run.milliseconds
        rows.append(
            (
                *(name, f"{run.rate:.0f}", f"{np.median(times):.1f}"),
                *(f"{np.percentile(times, 95):.1f}", f"{max(times):.1f}", str(run.anchors)),
                f"{median[0]:.3f} cm / {median[1]:.3f}°",
                f"{worst[0]:.2f} cm / {worst[1]:.2f}°",
                "/".join(str(run.count(s)) for s in ("tracking", "relocalized", "lost")),
                f"{run.rate / photos:.0f}",
            )
        )
    table(
        (
            *("frames", "a second", "median ms", "95% ms", "worst ms", "anchors"),
            *("median error", "worst error", "tracked/relocalized/lost"),
            "times one-photo",
        ),
        rows,
    )
    if plot is not None:
        figure, (axes,) = new_figure(1, 7.0, 3.5)
        for name, run in runs.items():
            axes.hist(run.milliseconds, bins=np.arange(0, 61, 1.5), alpha=0.6, label=name)
        axes.axvline(1000 / 30, color="0.4", linestyle="--", linewidth=1)
        axes.set_xlabel("milliseconds a frame (dashed: 30 frames a second)")
        axes.set_ylabel("frames")
        axes.legend()
        save_figure(figure, plot)


def measure_basin(localizer: Localizer, clips: list[list[View]], plot: Path | None) -> None:
    """There and back through each clip, so that even steps of 20 frames have a few."""
    rows, shares = [], []
    for skipped in SKIPPED:
        followed = right = frames = 0
        for clip in clips:
            there_and_back = [*clip, *clip[-2:0:-1]] * 3
            views = there_and_back[:: skipped + 1][:20]
            with Tracker(localizer, TrackingSettings(wait=True)) as tracker:
                for i, view in enumerate(views):
                    result = tracker.track(view.image, view.camera)
                    if i == 0:
                        continue
                    frames += 1
                    followed += result.status == "tracking"
                    error = error_of(result.cam_from_world, view.truth)
                    right += result.status == "tracking" and error.within(
                        ACCURATE.centimetres, ACCURATE.degrees
                    )
        shares.append(right / frames)
        rows.append(
            (str(skipped), str(frames), f"{followed / frames:.0%}", f"{right / frames:.0%}")
        )
    table(
        ("frames left out", "frames", "tracked, without the localizer", "within 5 cm and 2°"), rows
    )
    if plot is not None:
        figure, (axes,) = new_figure(1, 5.0, 3.5)
        axes.plot(SKIPPED, [100 * share for share in shares], marker="o")
        axes.set_xlabel("frames left out between two (30 a second)")
        axes.set_ylabel("tracked within 5 cm and 2°, %")
        axes.set_ylim(0, 105)
        save_figure(figure, plot)


def measure_memory(localizer: Localizer, clips: list[list[View]], count: int) -> None:
    """The same camera there and back, so that it is followed all the time."""
    loop = [*clips[0], *clips[0][-2:0:-1]]
    rows = []
    with Tracker(localizer, TrackingSettings(wait=True)) as tracker:
        lost, begin = 0, time.perf_counter()
        for i in range(count):
            view = loop[i % len(loop)]
            lost += tracker.track(view.image, view.camera).status == "lost"
            if (i + 1) % max(1, count // 10) == 0:
                rate = (i + 1) / (time.perf_counter() - begin)
                rows.append((str(i + 1), f"{_resident():.0f}", str(lost), f"{rate:.0f}"))
    table(("frames", "resident MB", "lost", "frames a second"), rows)


def _resident() -> float:
    """Megabytes of memory of this process (Linux)."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("map", help="of RedKitchen, from gscpe build-map")
    parser.add_argument("--backend", default="auto", choices=("auto", "gl", "cpu"))
    parser.add_argument("--fast", action="store_true", help="at half size alone")
    parser.add_argument("--clips", type=int, default=5, help="of the five, at most")
    parser.add_argument("--plot", type=Path, help="picture to write (extra: plots)")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--basin", action="store_true", help="frames that are left out")
    what.add_argument("--robustness", action="store_true", help="frames that are spoilt")
    what.add_argument("--memory", type=int, metavar="N", help="over so many frames")
    parser.add_argument("--kinds", nargs="+", choices=ALL_KINDS, help="of spoilt frames")
    options = parser.parse_args()
    clips = read_clips(redkitchen())[: options.clips]
    with Localizer(open_map(options.map), backend=options.backend) as localizer:
        print(f"{len(clips)} clips of {CLIP}, {localizer.renderer_description}\n")
        if options.basin:
            measure_basin(localizer, clips, options.plot)
        elif options.robustness:
            views = [[(v.image, v.camera, v.truth) for v in clip] for clip in clips]
            disturb(localizer, views, options.kinds or ALL_KINDS)
        elif options.memory:
            measure_memory(localizer, clips, options.memory)
        else:
            measure(localizer, clips, options.fast, options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
