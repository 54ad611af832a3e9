"""What the parts of tools/bench_refinement.py share: queries, starts, runs and their errors."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Iterable, Sequence, TypeVar

import numpy as np
from adam_baseline import AdamSettings, refine_by_adam
from refinement_recorder import Trajectory, record_ours
from tqdm import tqdm

from gscpe import LocalizationResult, Localizer, read_image
from gscpe.arrays import Float64Array, UInt8Array
from gscpe.geometry import pose_difference, se3
from gscpe.refinement import RefinementSettings
from gscpe.scene import Photo, to_photo
from gscpe.scene.poses.hloc import read_poses
from gscpe.scene.query_list import Query, read_query_list

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Case:
    """A query with its (4, 4) true pose; the photo is what the localizer would refine."""

    query: Query
    image: UInt8Array
    photo: Photo
    truth: Float64Array


@dataclass(frozen=True)
class Error:
    """Of a pose; infinite where there is none."""

    centimetres: float
    degrees: float

    def within(self, centimetres: float, degrees: float) -> bool:
        return self.centimetres <= centimetres and self.degrees <= degrees


def redkitchen() -> Path | None:
    data = Path(os.environ.get("GSCPE_DATA", "")) / "redkitchen"
    return data if data.is_dir() else None


def read_cases(localizer: Localizer, data: Path, count: int) -> list[Case]:
    """So many queries, evenly spaced."""
    truth, listed = read_poses(data / "truth.txt"), read_query_list(data / "queries.txt")
    chosen = np.linspace(0, len(listed) - 1, min(count, len(listed))).astype(int)
    cases = []
    for query in (listed[i] for i in chosen):
        image = read_image(data / "queries" / query.name)
        photo = localizer.at_the_maps_resolution(to_photo(image, query.camera))
        cases.append(Case(query, image, photo, truth[query.name]))
    return cases


def progress(items: Iterable[_T], label: str, total: int | None = None) -> Iterable[_T]:
    shown: Iterable[_T] = tqdm(
        items, label, total, leave=False, file=sys.stderr, disable=not sys.stderr.isatty()
    )
    return shown


def localize_cases(
    localizer: Localizer, cases: Sequence[Case]
) -> list[tuple[Case, LocalizationResult]]:
    """The whole pipeline; without the queries that have no coarse pose, which are named."""
    found = []
    for case in progress(cases, "localize"):
        result = localizer.localize(case.image, case.query.camera)
        if result.coarse is None or result.coarse.cam_from_world is None:
            print(f"left out, no coarse pose: {case.query.name}", file=sys.stderr)
            continue
        found.append((case, result))
    return found


def error_of(localizer: Localizer, case: Case, cam_from_world: Float64Array | None) -> Error:
    if cam_from_world is None:
        return Error(np.inf, np.inf)
    difference = pose_difference(cam_from_world, case.truth)
    unit = localizer.map.metres_per_unit or 1.0
    return Error(100.0 * difference.distance * unit, difference.degrees)


def displaced(
    cam_from_world: Float64Array, distance: float, degrees: float, rng: np.random.Generator
) -> Float64Array:
    """The camera moved by exactly so many map units and turned by exactly so many degrees,
    both in directions drawn at random, uniformly."""
    shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = se3.exp(np.concatenate([np.zeros(3), np.radians(degrees) * axis]))
    moved = turn @ cam_from_world
    moved[:3, 3] += distance * shift
    return np.asarray(moved)


@dataclass(frozen=True)
class Method:
    """A way to refine, by name; the trajectory ends with the pose found, or None if none was."""

    name: str
    run: Callable[[Localizer, Case, Float64Array], Trajectory | None]


def ours(localizer: Localizer, name: str = "Lucas-Kanade", **changes: Any) -> Method:
    """gscpe.refinement with the localizer's settings, some of them changed."""
    settings: RefinementSettings = replace(localizer.settings.refinement, **changes)

    def run(localizer: Localizer, case: Case, start: Float64Array) -> Trajectory | None:
        unit = localizer.map.metres_per_unit
        result, track = record_ours(localizer._renderer, case.photo, start, settings, unit)
        return None if result.cam_from_world is None else track

    return Method(name, run)


def adam(localizer: Localizer, name: str = "Adam", iterations: int = 20) -> Method:
    settings = AdamSettings(refinement=localizer.settings.refinement, iterations=iterations)

    def run(localizer: Localizer, case: Case, start: Float64Array) -> Trajectory | None:
        unit = localizer.map.metres_per_unit
        return refine_by_adam(localizer._renderer, case.photo, start, settings, unit)

    return Method(name, run)


def median_error(errors: Sequence[Error]) -> str:
    centimetres, degrees = ([getattr(e, a) for e in errors] for a in ("centimetres", "degrees"))
    return f"{np.median(centimetres):.3f} cm / {np.median(degrees):.3f}°"


def share(flags: Sequence[bool]) -> str:
    return f"{100 * np.mean(flags):.0f}%"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Prints Markdown."""
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)


def save_figure(figure: Any, path: Path, top: float = 1.0) -> None:
    """Leaves what is above ``top``, a share of the height, for a legend."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.tight_layout(rect=(0.0, 0.0, 1.0, top))
    figure.savefig(path, metadata={"Software": None})


def new_figure(columns: int, width: float, height: float) -> tuple[Any, list[Any]]:
    """A matplotlib figure (extra: plots) and its axes, side by side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=80)
    FigureCanvasAgg(figure)
    return figure, [figure.add_subplot(1, columns, i + 1) for i in range(columns)]
