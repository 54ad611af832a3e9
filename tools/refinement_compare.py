# SPDX-License-Identifier: Apache-2.0
"""Lucas-Kanade and Adam from the same starts: final errors, seconds, how far off they may be."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from typing import Sequence

import numpy as np
from _common import (
    Case,
    Error,
    median_error,
    new_figure,
    progress,
    save_figure,
    table,
    within,
)
from adam_baseline import AdamSettings
from refinement_methods import (
    Method,
    Start,
    Trajectory,
    adam,
    coarse_starts,
    displaced,
    lucas_kanade,
)

from gscpe import Localizer
from gscpe.arrays import Float64Array

DISPLACED = ((0.5, 0.15), (3.0, 1.0))
"""Centimetres and degrees beside the truth, to compare from."""
DISTANCES = ((2.0, 1.0), (5.0, 2.0), (10.0, 4.0), (20.0, 8.0), (30.0, 12.0))
"""The same, to see how far off a start may be."""


class Course:
    """The median error over the queries at any time since the start: (T,) seconds, with all
    or of the solver alone, (T, 2) centimetres and degrees."""

    def __init__(
        self, tracks: Sequence[Trajectory], errors: Sequence[Float64Array], solver: bool
    ) -> None:
        times = [track.solver_seconds if solver else track.seconds for track in tracks]
        self.seconds = np.unique(np.concatenate([t - t[0] for t in times]))
        at = [np.searchsorted(t - t[0], self.seconds, side="right") - 1 for t in times]
        self.errors = np.median([e[i] for e, i in zip(errors, at, strict=True)], axis=0)
        self.end = float(np.median([t[-1] - t[0] for t in times]))

    def reaches(self, target: Float64Array) -> float:
        """When both errors fall to the target, (2,), for good; infinite if they do not."""
        above = np.flatnonzero(np.any(self.errors > target + 1e-12, axis=1))
        if not len(above):
            return 0.0
        after = above[-1] + 1
        return float(self.seconds[after]) if after < len(self.seconds) else np.inf


def compare(localizer: Localizer, cases: Sequence[Case], iterations: int) -> None:
    """Prints the tables; Adam has so many iterations a level."""
    refinement, rng = localizer.settings.refinement, np.random.default_rng(0)
    starts = {
        _label(cm, degrees): _displaced(localizer, cases, cm, degrees, rng)
        for cm, degrees in DISPLACED
    }
    starts["coarse pose"] = [start for start, _ in coarse_starts(localizer, cases)]
    methods = (
        lucas_kanade(refinement),
        adam(AdamSettings(refinement=refinement, iterations=iterations)),
    )
    rows, ratios = [], []
    for label, of_start in starts.items():
        errors = [start.error(localizer, start.cam_from_world) for start in of_start]
        rows.append([label, "(start)", median_error(errors), within(errors, 1.0, 1.0), "", ""])
        courses: list[tuple[Course, Course]] = []
        for method in methods:
            tracks, on_the_way, failed = _run(localizer, method, of_start)
            ends = [Error(*e[-1]) for e in on_the_way] + [Error(np.inf, np.inf)] * failed
            with_all, solver = (Course(tracks, on_the_way, alone) for alone in (False, True))
            courses.append((solver, with_all))
            rows.append(
                [label, method.name, median_error(ends), within(ends, 1.0, 1.0),
                 f"{solver.end:.3f}", f"{with_all.end:.3f}"]
            )  # fmt: skip
        ratios.append([label, *(_ratio(*both) for both in zip(*courses, strict=True))])
    table(
        ["start", "", "median error", "1 cm/1°", "s, solver alone", "s, with renders and masks"],
        rows,
    )
    print("\nTime until the median error is, for good, Adam's final one, as a share of Adam's:\n")
    table(["start", "solver alone", "with renders and masks"], ratios)


def measure_basin(
    localizer: Localizer, cases: Sequence[Case], draws: int, plot: Path | None
) -> None:
    """The share of random starts that end within 1 cm and 1 degree: so many draws at each
    distance, the queries in turn; the same for every method."""
    refinement = localizer.settings.refinement
    levels = sorted({refinement.levels, localizer.settings.tracking_levels})
    methods = [
        lucas_kanade(replace(refinement, levels=n), f"Lucas-Kanade, S = {n}") for n in levels
    ]
    methods.append(adam(AdamSettings(refinement=refinement), f"Adam, S = {refinement.levels}"))
    shares: dict[str, list[float]] = {method.name: [] for method in methods}
    for cm, degrees in DISTANCES:
        drawn = list(islice(cycle(cases), draws))
        starts = _displaced(localizer, drawn, cm, degrees, np.random.default_rng(0))
        for method in methods:
            near = []
            for start in progress(starts, f"{method.name}, {cm:g} cm", draws):
                track = start.run(localizer, method)
                end = None if track is None else track.cam_from_world[-1]
                near.append(start.error(localizer, end).within(1.0, 1.0))
            shares[method.name].append(float(np.mean(near)))
    print(f"Share of {draws} starts a distance that end within 1 cm and 1°:\n")
    table(
        ["", *(_label(cm, degrees) for cm, degrees in DISTANCES)],
        ([name, *(f"{100 * s:.0f}%" for s in of_method)] for name, of_method in shares.items()),
    )
    if plot is not None:
        draw(shares, plot)


def _label(centimetres: float, degrees: float) -> str:
    return f"{centimetres:g} cm / {degrees:g}°"


def _displaced(
    localizer: Localizer,
    cases: Sequence[Case],
    centimetres: float,
    degrees: float,
    rng: np.random.Generator,
) -> list[Start]:
    distance = centimetres / 100 / (localizer.map.metres_per_unit or 1.0)
    return [Start(case, displaced(case.truth, distance, degrees, rng)) for case in cases]


def _run(
    localizer: Localizer, method: Method, starts: Sequence[Start]
) -> tuple[list[Trajectory], list[Float64Array], int]:
    """Trajectories, their errors, (T, 2) each, and how many starts gave none."""
    tracks, errors = [], []
    for start in progress(starts, method.name, len(starts)):
        track = start.run(localizer, method)
        if track is None:
            continue
        tracks.append(track)
        poses = [start.error(localizer, pose) for pose in track.cam_from_world]
        errors.append(np.array([[e.centimetres, e.degrees] for e in poses]))
    return tracks, errors, len(starts) - len(tracks)


def _ratio(first: Course, second: Course) -> str:
    """Of the first method's time to the second's."""
    seconds = first.reaches(second.errors[-1])
    if seconds == 0.0:
        return "the start is as good"
    if np.isinf(seconds):
        return "not reached"
    return f"{seconds / second.end:.2f} ({seconds:.3f} of {second.end:.3f} s)"


def draw(shares: dict[str, list[float]], path: Path) -> None:
    """Shares by the distance of the start."""
    figure, (axis,) = new_figure(1, 5.5, 3.4)
    for (name, of_method), style in zip(shares.items(), ("o-", "s-", "^--"), strict=False):
        axis.plot([cm for cm, _ in DISTANCES], [100 * s for s in of_method], style, label=name)
    axis.set_xticks([cm for cm, _ in DISTANCES])
    axis.set_xticklabels([f"{cm:g} cm\n{degrees:g}°" for cm, degrees in DISTANCES])
    axis.set_xlabel("start beside the true pose")
    axis.set_ylabel("ends within 1 cm and 1°, %")
    axis.set_ylim(-3, 103)
    axis.grid(visible=True, alpha=0.25)
    axis.legend(loc=(0.12, 0.12))
    save_figure(figure, path)
