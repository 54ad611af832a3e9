# SPDX-License-Identifier: Apache-2.0
"""What the tools share: the RedKitchen queries of $GSCPE_DATA, errors, tables, pictures."""

from __future__ import annotations

import os
import resource
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Iterable, Sequence, TypeVar

import numpy as np
from tqdm import tqdm

from gscpe import Localizer, read_image
from gscpe.arrays import Float64Array, UInt8Array
from gscpe.geometry import pose_difference
from gscpe.geometry.spread import thinned
from gscpe.photos import Photo, to_photo
from gscpe.poses import read_pose_file
from gscpe.scene.query_list import Query, read_query_list

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Case:
    """A query with its (4, 4) true pose."""

    query: Query
    image: UInt8Array
    truth: Float64Array

    def photo_in(self, localizer: Localizer) -> Photo:
        """What the localizer refines."""
        return localizer.at_the_maps_resolution(to_photo(self.image, self.query.camera))


@dataclass(frozen=True)
class Error:
    """Of a pose; infinite where there is none."""

    centimetres: float
    degrees: float

    def within(self, centimetres: float, degrees: float) -> bool:
        return self.centimetres <= centimetres and self.degrees <= degrees


def redkitchen() -> Path:
    """The data's folder; the program ends where there is none."""
    data = Path(os.environ.get("GSCPE_DATA", "")) / "redkitchen"
    if not data.is_dir():
        print("set GSCPE_DATA to the folder that holds redkitchen/", file=sys.stderr)
        sys.exit(2)
    return data


def read_queries(data: Path, count: int) -> list[Query]:
    """So many queries, evenly spaced."""
    listed = read_query_list(data / "queries.txt")
    return thinned(listed, count)


def read_cases(data: Path, count: int) -> list[Case]:
    truth = read_pose_file(data / "truth.txt").poses
    return [
        Case(query, read_image(data / "queries" / query.name), truth[query.name])
        for query in read_queries(data, count)
    ]


def error_of(cam_from_world: Float64Array | None, truth: Float64Array, unit: float = 1.0) -> Error:
    """In a map of so many metres a unit."""
    if cam_from_world is None:
        return Error(np.inf, np.inf)
    difference = pose_difference(cam_from_world, truth)
    return Error(100.0 * difference.distance * unit, difference.degrees)


def median_error(errors: Sequence[Error]) -> str:
    centimetres, degrees = ([getattr(e, a) for e in errors] for a in ("centimetres", "degrees"))
    return f"{np.median(centimetres):.3f} cm / {np.median(degrees):.3f}°"


def within(errors: Sequence[Error], centimetres: float, degrees: float) -> str:
    return share([error.within(centimetres, degrees) for error in errors])


def share(flags: Sequence[bool]) -> str:
    return f"{100 * np.mean(flags):.0f}%"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Prints Markdown."""
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)


def progress(items: Iterable[_T], label: str, total: int | None = None) -> Iterable[_T]:
    shown: Iterable[_T] = tqdm(
        items, label, total, leave=False, file=sys.stderr, disable=not sys.stderr.isatty()
    )
    return shown


def new_figure(columns: int, width: float, height: float) -> tuple[Any, list[Any]]:
    """A matplotlib figure (extra: plots) and its axes, side by side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=80)
    FigureCanvasAgg(figure)
    return figure, [figure.add_subplot(1, columns, i + 1) for i in range(columns)]


def save_figure(figure: Any, path: Path, top: float = 1.0) -> None:
    """Leaves what is above ``top``, a share of the height, for a legend."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.tight_layout(rect=(0.0, 0.0, 1.0, top))
    figure.savefig(path, metadata={"Software": None})


def peak_bytes() -> float:
    """What this process held at most so far. On Linux, processes that started it do not count."""
    status = Path("/proc/self/status")
    if not status.exists():
        unit = 1 if sys.platform == "darwin" else 1024
        return float(unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return 1024.0 * float(line.split()[1])
