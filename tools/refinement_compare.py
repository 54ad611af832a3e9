"""Lucas-Kanade and Adam from the same starts: final errors, seconds, error against time."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import numpy as np
from refinement_cases import (
    Case,
    Error,
    Method,
    adam,
    displaced,
    error_of,
    localize_cases,
    median_error,
    new_figure,
    ours,
    progress,
    save_figure,
    share,
    table,
)
from refinement_recorder import Trajectory

from gscpe import Localizer
from gscpe.arrays import Float64Array

DISPLACED = ((0.5, 0.15), (3.0, 1.0))
"""Centimetres and degrees beside the truth."""


class Course:
    """The median error over the queries at any time since the start: (T,) seconds, with all
    or of the solver alone, (T, 2) centimetres and degrees."""

    def __init__(self, tracks: Sequence[Trajectory], errors: Sequence[Float64Array], solver: bool):
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


def compare(localizer: Localizer, cases: list[Case], iterations: int, plot: Path | None) -> None:
    """Prints the tables; Adam has so many iterations a level."""
    rng = np.random.default_rng(0)
    unit = localizer.map.metres_per_unit or 1.0
    starts = {
        f"{cm:g} cm / {degrees:g}°": [
            (case, displaced(case.truth, cm / 100 / unit, degrees, rng)) for case in cases
        ]
        for cm, degrees in DISPLACED
    }
    starts["coarse pose"] = [
        (case, result.coarse.cam_from_world)
        for case, result in localize_cases(localizer, cases)
        if result.coarse is not None and result.coarse.cam_from_world is not None
    ]
    methods = (ours(localizer), adam(localizer, iterations=iterations))
    courses: dict[str, dict[str, tuple[Course, Course]]] = {}
    rows, splits, ratios = [], [], []
    for label, of_start in starts.items():
        errors = [error_of(localizer, case, start) for case, start in of_start]
        rows.append([label, "(start)", median_error(errors), _within(errors), "", ""])
        courses[label] = {}
        for method in methods:
            tracks, course_errors, failed = _run(localizer, method, of_start)
            ends = [Error(*e[-1]) for e in course_errors] + [Error(np.inf, np.inf)] * failed
            with_all, solver = (Course(tracks, course_errors, alone) for alone in (False, True))
            courses[label][method.name] = with_all, solver
            rows.append(
                [label, method.name, median_error(ends), _within(ends), f"{solver.end:.3f}",
                 f"{with_all.end:.3f}"]
            )  # fmt: skip
            splits.append([label, method.name, *_split(tracks)])
        ratios.append([label, *_ratios(courses[label], [m.name for m in methods])])
    print()
    table(
        ["start", "", "median error", "1 cm/1°", "s, solver alone", "s, with renders and masks"],
        rows,
    )
    print("\nA query's seconds (medians) and renders (means):\n")
    table(
        ["start", "", "anchors, s", "mask views, s", "mask, s", "solver, s", "anchors",
         "mask views"],
        splits,
    )  # fmt: skip
    print("\nTime until the median error is, for good, Adam's final one, as a share of Adam's:\n")
    table(["start", "solver alone", "with renders and masks"], ratios)
    if plot is not None:
        draw(courses, plot)


def _within(errors: Sequence[Error]) -> str:
    return share([error.within(1.0, 1.0) for error in errors])


def _run(
    localizer: Localizer, method: Method, of_start: Sequence[tuple[Case, Float64Array]]
) -> tuple[list[Trajectory], list[Float64Array], int]:
    """Trajectories, their errors, (T, 2) each, and how many starts gave none."""
    tracks, errors = [], []
    for case, start in progress(of_start, method.name, len(of_start)):
        track = method.run(localizer, case, start)
        if track is None:
            continue
        tracks.append(track)
        poses = [error_of(localizer, case, pose) for pose in track.cam_from_world]
        errors.append(np.array([[e.centimetres, e.degrees] for e in poses]))
    return tracks, errors, len(of_start) - len(tracks)


def _split(tracks: Sequence[Trajectory]) -> list[str]:
    seconds = (
        [track.anchor_rendering for track in tracks],
        [track.mask_rendering for track in tracks],
        [track.masking for track in tracks],
        [track.solver_seconds[-1] for track in tracks],
    )
    renders = [t.anchors for t in tracks], [t.mask_views for t in tracks]
    return [f"{np.median(s):.3f}" for s in seconds] + [f"{np.mean(r):.1f}" for r in renders]


def _ratios(courses: dict[str, tuple[Course, Course]], names: Sequence[str]) -> list[str]:
    """Of the first method's time to the second's."""
    cells = []
    for which in (1, 0):
        first, second = (courses[name][which] for name in names)
        seconds = first.reaches(second.errors[-1])
        if seconds == 0.0:
            cells.append("the start is as good")
        elif np.isinf(seconds):
            cells.append("not reached")
        else:
            cells.append(f"{seconds / second.end:.2f} ({seconds:.3f} of {second.end:.3f} s)")
    return cells


def draw(courses: dict[str, dict[str, tuple[Course, Course]]], path: Path) -> None:
    """Median error against time, renders included; the solver's own time dashed."""
    figure, axes = new_figure(len(courses), 3.4 * len(courses), 3.6)
    for axis, (label, methods) in zip(axes, courses.items(), strict=True):
        for colour, (name, (with_all, solver)) in zip(("C0", "C1"), methods.items(), strict=True):
            for course, style, suffix in ((with_all, "-", ""), (solver, "--", ", solver alone")):
                axis.step(
                    course.seconds,
                    course.errors[:, 0],
                    colour + style,
                    where="post",
                    label=name + suffix,
                )
        axis.set_title(f"from {label}")
        axis.set_yscale("log")
        for ticks in (axis.yaxis.set_major_formatter, axis.yaxis.set_minor_formatter):
            ticks(_short)
        axis.set_xlabel("seconds")
        axis.grid(visible=True, which="both", alpha=0.25)
    axes[0].set_ylabel("median error, cm")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="upper center", ncol=4)
    save_figure(figure, path, top=0.92)


def _short(value: float, _: int | None) -> str:
    """Few labels, and no powers of ten: 0.1, 0.2, 0.3, 0.5, 1, ..."""
    return f"{value:g}" if f"{value:e}"[0] in "1235" else ""
