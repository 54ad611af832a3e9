"""Localizes a list of photos; what is finished is on disk, so that it can be resumed.

A photo that cannot be read fails alone. The details file is the record of what is
finished: one JSON object a line (docs/formats.md). The pose files are written from it, and
resuming reads it: photos that failed, or whose camera has changed, are done again.
"""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array
from gscpe.errors import InputError, OutputError
from gscpe.localization_result import LocalizationResult
from gscpe.localizer import Localizer
from gscpe.scene import read_image
from gscpe.scene.pose_file import format_pose
from gscpe.scene.query_list import Query

_log = logging.getLogger(__name__)

_FIELDS = {"name", "camera", "status", "reason", "cam_from_world", "coarse", "refined"}


def localize_list(
    localizer: Localizer,
    queries: Sequence[Query],
    image_folder: str | Path,
    details_path: str | Path,
    resume: bool = False,
    progress: bool = False,
) -> list[dict[str, Any]]:
    """Localizes every query and returns their details, in the order of the list.

    Args:
        localizer: of the map.
        queries: photos and cameras.
        image_folder: that their names are relative to.
        details_path: gets a line a query as soon as it is finished.
        resume: keep what is in ``details_path`` already; otherwise it is begun anew, and
            what was there is kept beside it with the ending ``.bak``.
        progress: show a bar.

    Raises:
        OutputError: the details cannot be written.
        RenderError: OpenGL failed.
    """
    details_path = Path(details_path)
    before = read_details(details_path) if resume else {}
    finished = {
        query.name: before[query.name]
        for query in queries
        if query.name in before and _still_holds(before[query.name], query)
    }
    try:
        details_path.parent.mkdir(parents=True, exist_ok=True)
        if not resume and details_path.is_file() and details_path.stat().st_size:
            backup = details_path.with_name(details_path.name + ".bak")
            details_path.replace(backup)
            _log.warning("what was finished before is kept in %s", backup)
        # Rewritten, so that a line cut off by the interruption does not stay.
        details_path.write_text("".join(json.dumps(d) + "\n" for d in finished.values()))
        with (
            details_path.open("a") as file,
            tqdm(total=len(queries), unit="photo", disable=not progress) as bar,
        ):
            bar.update(len(finished))
            for query in queries:
                if query.name in finished:
                    continue
                detail = _localize_one(localizer, query, Path(image_folder))
                finished[query.name] = detail
                file.write(json.dumps(detail) + "\n")
                file.flush()
                bar.update()
                localized = sum(d["status"] == "localized" for d in finished.values())
                bar.set_postfix_str(f"{localized} localized")
    except OSError as error:
        raise OutputError(f"{details_path} cannot be written: {error.strerror}") from error
    return [finished[query.name] for query in queries]


def read_details(path: str | Path) -> dict[str, dict[str, Any]]:
    """Details by name; lines that were cut off are left out. Empty when there is no file."""
    details: dict[str, dict[str, Any]] = {}
    path = Path(path)
    try:
        lines = path.read_text().splitlines() if path.exists() else []
    except (OSError, UnicodeDecodeError) as error:
        raise OutputError(f"{path} exists but is not a details file; choose another") from error
    for line in lines:
        try:
            detail = json.loads(line)
            complete = detail.keys() >= _FIELDS
        except (ValueError, AttributeError):
            complete = False
        if complete:
            details[str(detail["name"])] = detail
        else:
            _log.warning("%s: an incomplete line is left out", path)
    return details


def check_outputs(paths: Sequence[str | Path | None], inputs: Sequence[str | Path] = ()) -> None:
    """Raises OutputError, before any long work, when one of the files cannot be written, is
    one of the inputs, or comes twice."""
    taken = {Path(path).resolve() for path in inputs}
    for path in (Path(path) for path in paths if path is not None):
        if path.resolve() in taken:
            raise OutputError(f"{path} is given twice; each input and output needs its own file")
        taken.add(path.resolve())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("a"):
                pass
        except OSError as error:
            raise OutputError(f"{path} cannot be written: {error.strerror}") from error


def write_poses(details: Sequence[Mapping[str, Any]], path: str | Path, stage: str) -> None:
    """Writes hloc's pose file with the localized photos' poses of a stage.

    Args:
        details: of :func:`localize_list`.
        path: of the pose file.
        stage: ``"final"``; or that of one stage alone, ``"coarse"`` or ``"refined"``.

    Raises:
        OutputError: the file cannot be written.
    """
    lines = []
    for detail in details:
        source = detail if stage == "final" else detail[stage]
        if detail["status"] == "localized" and source is not None:
            lines.append(f"{detail['name']} {source['cam_from_world']}\n")
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_text("".join(lines))
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from error


def result_details(query: Query, result: LocalizationResult) -> dict[str, Any]:
    """A result as plain data for JSON (docs/formats.md says what each field is)."""
    coarse, refined = result.coarse, result.refined
    return {
        "name": query.name,
        "camera": query.camera.colmap_text(),
        "status": "localized" if result.localized else "not localized",
        "reason": result.reason,
        "cam_from_world": _pose(result.cam_from_world),
        "started_from": result.started_from,
        "reference": result.reference,
        "hypotheses": result.hypotheses,
        "coarse": coarse
        and {
            "cam_from_world": _pose(coarse.cam_from_world),
            "matches": coarse.matches,
            "inliers": coarse.inliers,
            "rms_pixels": _number(coarse.rms_pixels),
            "covariance": None if coarse.covariance is None else coarse.covariance.tolist(),
            "rounds": coarse.rounds,
            "converged": coarse.converged,
        },
        "refined": refined
        and {
            "cam_from_world": _pose(refined.cam_from_world),
            "residual": _number(refined.residual),
            "agreement": _number(refined.agreement),
            "overlap": _number(refined.overlap),
            "gain": _number(refined.gain),
            "bias": _number(refined.bias),
            "pixels": refined.pixels,
            "anchors": refined.anchors,
            "converged": refined.converged,
        },
        "covariance": None if result.covariance is None else result.covariance.tolist(),
        "seconds": {stage: round(value, 4) for stage, value in result.seconds.items()},
    }


def _localize_one(localizer: Localizer, query: Query, image_folder: Path) -> dict[str, Any]:
    try:
        image = read_image(image_folder / query.name)
        return result_details(query, localizer.localize(image, query.camera))
    except InputError as error:
        return {
            "name": query.name,
            "camera": query.camera.colmap_text(),
            "status": "failed",
            "reason": str(error),
            "cam_from_world": None,
            "started_from": None,
            "reference": None,
            "hypotheses": 0,
            "coarse": None,
            "refined": None,
            "covariance": None,
            "seconds": {},
        }


def _still_holds(detail: Mapping[str, Any], query: Query) -> bool:
    return bool(detail["status"] != "failed" and detail["camera"] == query.camera.colmap_text())


def _pose(cam_from_world: Float64Array | None) -> str | None:
    return None if cam_from_world is None else format_pose(cam_from_world)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
