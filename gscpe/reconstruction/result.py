# SPDX-License-Identifier: Apache-2.0
"""What came of photos that were put together."""

from __future__ import annotations

import logging
import time
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Iterator, Mapping, Sequence

from gscpe.errors import ReconstructionError
from gscpe.given import parse_json, real_path
from gscpe.reconstruction.disk import when_full
from gscpe.reconstruction.frame import ModelFrame
from gscpe.reconstruction.photos import PreparedPhoto
from gscpe.reconstruction.settings import ReconstructionSettings
from gscpe.reconstruction.work_folder import write_kept

_log = logging.getLogger(__name__)

RESULT = "reconstruction.json"
BYTES_A_PHOTO = 4_000_000  # features, and matches with thirty others
FEW_FEATURES = 100


@dataclass(frozen=True)
class RefinedPoses:
    """How known poses were refined.

    Attributes:
        error_before, error_after: how far matches are from where the poses want them (Sampson
            distance), median, pixels; the same matches, between photos that were placed.
        moved, moved_most: distance of the cameras from where they were, median and largest, units
            of the poses.
        turned: angle between orientations before and after, median, degrees.
        groups: how many sets of photos see no point in common; one's position with respect to
            another is as it was given.
    """

    error_before: float
    error_after: float
    moved: float
    moved_most: float
    turned: float
    groups: int

    def __str__(self) -> str:
        apart = "" if self.groups == 1 else f", in {self.groups} groups without a common point"
        return (
            f"poses moved by {self.moved:.3g} units and {self.turned:.2f} degrees (median; at most "
            f"{self.moved_most:.3g} units){apart}: matches fit them by {self.error_after:.2f} px "
            f"instead of {self.error_before:.2f}"
        )


@dataclass(frozen=True)
class Reconstruction:
    """What came of photos that were put together.

    Attributes:
        model_folder: COLMAP model, with points.
        image_folder: the photos that it is of: upright, and not larger than asked for.
        placed: names of the photos that have a pose.
        not_placed: why the others have none, by name.
        other_models: names of photos that hang together, but not with those that were placed.
        points: their number.
        error: mean distance of the points' images from the features, pixels.
        frame: unit and axes of the model.
        seconds: by step.
        refined: where poses were known before.
    """

    model_folder: Path
    image_folder: Path
    placed: tuple[str, ...]
    not_placed: Mapping[str, str]
    other_models: tuple[tuple[str, ...], ...]
    points: int
    error: float
    frame: ModelFrame
    seconds: Mapping[str, float] = field(default_factory=dict)
    refined: RefinedPoses | None = None

    def __str__(self) -> str:
        count = len(self.placed) + len(self.not_placed)
        unit = self.frame.metres_per_unit
        length = "of unknown length" if unit is None else f"= {unit:g} m"
        return (
            f"{len(self.placed)} of {count} photos placed, {self.points} points, "
            f"{self.error:.2f} px, 1 unit {length}" + (f"; {self.refined}" if self.refined else "")
        )


def why_not_placed(
    photos: Sequence[PreparedPhoto],
    unusable: Mapping[str, str],
    placed: set[str],
    others: Sequence[Sequence[str]],
    features: Mapping[str, int],
    shared: Mapping[str, int],
    settings: ReconstructionSettings,
) -> dict[str, str]:
    """Why, by name."""
    reasons = dict(unusable)
    elsewhere = {name: len(names) for names in others for name in names}
    for photo in photos:
        name = photo.name
        if name in placed:
            continue
        if name in elsewhere:
            reasons[name] = (
                f"is one of {elsewhere[name]} photos that hang together among themselves alone: "
                "photos between them and the others are missing"
            )
        elif photo.sharpness < settings.min_sharpness:
            reasons[name] = "is blurred"
        elif features.get(name, 0) < FEW_FEATURES:
            reasons[name] = f"has hardly any features ({features.get(name, 0)}): blank, or too dark"
        elif not shared.get(name, 0):
            reasons[name] = "shows nothing that another photo shows too"
        else:
            reasons[name] = (
                f"shares something with {shared[name]} others, but not enough to tell its pose"
            )
    return dict(sorted(reasons.items()))


def stamp_of(settings: ReconstructionSettings, masks: str | Path | None) -> dict[str, Any]:
    """What of a run's settings must be the same where it is gone on with; JSON."""
    where = None if masks is None else str(real_path(masks))
    return {"settings": asdict(settings), "masks": where}


def write_model(model: Any, folder: Path) -> Path:
    """Writes a pycolmap.Reconstruction to ``sparse/0`` in a folder, which is returned.

    Raises:
        OutputError: it cannot be written.
    """
    sparse = folder / "sparse" / "0"
    with when_full(sparse):
        sparse.mkdir(parents=True, exist_ok=True)
        model.write(str(sparse))
    return sparse


def write_result(path: Path, result: Reconstruction) -> None:
    """For people and programs.

    Raises:
        OutputError: it cannot be written.
    """
    data: dict[str, Any] = asdict(result)
    for name in ("model_folder", "image_folder"):
        data[name] = str(getattr(result, name).relative_to(path.parent))
    write_kept(path, data)


def read_result(path: Path) -> Reconstruction:
    """What :func:`write_result` wrote.

    Raises:
        ReconstructionError: it is damaged.
    """
    try:
        data = parse_json(path.read_text(encoding="utf-8"))
        refined = data["refined"]
        frame = data["frame"]
        return Reconstruction(
            **{
                **data,
                "model_folder": path.parent / data["model_folder"],
                "image_folder": path.parent / data["image_folder"],
                "placed": tuple(data["placed"]),
                "other_models": tuple(map(tuple, data["other_models"])),
                "frame": ModelFrame(
                    frame["metres_per_unit"],
                    frame["up"] and tuple(frame["up"]),
                    frame["gps_origin"] and tuple(frame["gps_origin"]),
                ),
                "refined": refined and RefinedPoses(**refined),
            }
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ReconstructionError(
            f"{path} is damaged ({error}); delete {path.parent} and begin anew"
        ) from error


class Clock:
    """Seconds by step."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Times what is done meanwhile."""
        begin = time.perf_counter()
        yield
        self.seconds[name] = round(time.perf_counter() - begin, 2)
        _log.info("%s: %.1f s", name, self.seconds[name])
