# SPDX-License-Identifier: Apache-2.0
"""``gscpe evaluate``."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any, Mapping

from gscpe.arrays import Float64Array
from gscpe.cli.common import Commands, print_json
from gscpe.errors import SettingsError
from gscpe.evaluation import THRESHOLDS, Evaluation, Explanation, evaluate, explain_errors
from gscpe.photos.photo_name import with_slashes
from gscpe.poses import PoseFile, poses_by_name, read_pose_file

_CHANGES = {
    "quaternion": "with the quaternion's real part taken from the end (x y z w)",
    "inverted": "inverted (camera to world, where world to camera is expected)",
    "opengl": "with OpenGL's axes (y up, z backward) turned to OpenCV's",
}


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("evaluate", help="compare poses, in metres, with the truth")
    parser.add_argument("poses", help="estimates: a pose file of any form, see docs/formats.md")
    parser.add_argument("truth", help="the true poses of all queries, of any form too")
    unit = parser.add_mutually_exclusive_group()
    unit.add_argument(
        "--metres-per-unit",
        type=float,
        default=1.0,
        metavar="METRES",
        help="length of a unit of both files in metres (default: %(default)s)",
    )
    unit.add_argument(
        "--unknown-scale",
        action="store_true",
        help="the length of a unit is unknown: print positions in units, and no shares",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    unit: float | None = options.metres_per_unit
    if unit is None or not (math.isfinite(unit) and unit > 0):
        raise SettingsError(f"--metres-per-unit must be positive, not {unit:g}")
    if options.unknown_scale:
        unit = None
    estimates = read_pose_file(options.poses, keep_not_finite=True)
    truth = read_pose_file(options.truth)
    estimated, known, by_position = _with_common_names(estimates, truth)
    result = evaluate(estimated, known, unit)
    explanation = explain_errors(estimated, known)
    if options.json:
        print_json(
            {
                "queries": result.queries,
                "localized": result.localized,
                **_medians(result, unit),
                "within": [
                    {"position_m": metres, "rotation_degrees": degrees, "share": _number(share)}
                    for (metres, degrees), share in zip(THRESHOLDS, result.shares, strict=True)
                ],
                "not_in_truth": result.ignored,
                "not_finite": len(estimates.not_finite),
                "metres_per_unit": unit,
                "matched_by_position": by_position,
                "explanation": _explanation(explanation, unit),
            }
        )
        return 0
    print(f"localized        {result.localized} of {result.queries} photos of the truth list")
    if result.localized:
        of = "" if result.localized == result.queries else f" (of these {result.localized})"
        print(f"median position  {_length(result.median_distance, unit and 1.0)}{of}")
        print(f"median rotation  {result.median_degrees:.3f} deg{of}")
    for (metres, degrees), share in zip(THRESHOLDS, result.shares, strict=True):
        if unit is not None:
            limit = f"{100 * metres:.0f} cm / {degrees:.0f} deg"
            print(f"within {limit:<15} {100.0 * share:5.1f} %")
    if result.localized < result.queries:
        print("photos without a pose count as beyond every limit")
    if estimates.not_finite:
        print(f"{len(estimates.not_finite)} of these have one that is not finite")
    if result.ignored:
        print(f"{result.ignored} estimates are of photos that are not in the truth list")
    if by_position and len(estimated) < len(known):
        print(
            f"{options.poses} holds {len(estimated)} poses for {len(known)} photos. Its "
            "timestamps were read as positions in the truth list, starting at 0; if they number "
            "the poses of the file instead, all errors above are wrong",
            file=sys.stderr,
        )
    elif by_position:
        print("timestamps were read as positions in the truth list, starting at 0")
    if explanation is not None:
        path = options.truth if explanation.of_truth else options.poses
        print(_said(explanation, result, path, unit), file=sys.stderr)
    return 0


def _with_common_names(
    estimates: PoseFile, truth: PoseFile
) -> tuple[Mapping[str, Float64Array], Mapping[str, Float64Array], bool]:
    """Estimates and truth under the same names, where one or both are TUM's, or of Windows;
    whether timestamps were taken as positions."""
    if "tum" not in (estimates.format, truth.format) or not (estimates.poses and truth.poses):
        return *_with_slashes(estimates.poses, truth.poses), False
    if estimates.format == "tum":
        named, how = poses_by_name(estimates.poses, list(truth.poses))
        return named, truth.poses, how == "position"
    # Photos may lack an estimate, so positions among the estimates say nothing.
    named, _ = poses_by_name(truth.poses, list(estimates.poses), by_position=False)
    return estimates.poses, named, False


def _with_slashes(
    estimates: Mapping[str, Float64Array], truth: Mapping[str, Float64Array]
) -> tuple[Mapping[str, Float64Array], Mapping[str, Float64Array]]:
    """Both with ``/`` for backslashes, unless two names of a file would be one then."""
    a, b = ({with_slashes(name): p for name, p in poses.items()} for poses in (estimates, truth))
    return (a, b) if len(a) == len(estimates) and len(b) == len(truth) else (estimates, truth)


def _said(explanation: Explanation, result: Evaluation, path: str, unit: float | None) -> str:
    """One line for people, with the figures of both."""
    how = [_CHANGES[change] for change in explanation.changes]
    if explanation.motion is not None:
        scale = explanation.motion.scale
        how.append(
            "after one rigid motion of all (another frame)"
            if scale == 1.0
            else f"after one motion and a scale of {scale:.6g} for all (another frame and unit)"
        )
    then = _length(explanation.median_distance, unit)
    now = _length(result.median_distance, unit and 1.0)
    return (
        f"{path} seems to use another convention or frame: {'; '.join(how)}, they would be "
        f"{then} / {explanation.median_degrees:.3f} deg off, not {now} / "
        f"{result.median_degrees:.3f} deg (medians)"
    )


def _medians(of: Evaluation | Explanation, unit: float | None) -> dict[str, float | None]:
    """For JSON; an evaluation is in metres already, where the unit is known."""
    factor = unit if unit is not None and isinstance(of, Explanation) else 1.0
    key = "median_position_units" if unit is None else "median_position_m"
    return {
        key: _number(factor * of.median_distance),
        "median_rotation_degrees": _number(of.median_degrees),
    }


def _explanation(explanation: Explanation | None, unit: float | None) -> dict[str, Any] | None:
    if explanation is None:
        return None
    motion = explanation.motion
    return {
        "wrong": "truth" if explanation.of_truth else "estimates",
        "undone": list(explanation.changes),
        "motion": motion
        and {
            "rotation": motion.rotation.tolist(),
            "translation": motion.translation.tolist(),
            "scale": motion.scale,
        },
        **_medians(explanation, unit),
    }


def _length(value: float, metres: float | None) -> str:
    """A length with its unit; ``metres`` that one of ``value`` is, None where nobody knows."""
    return f"{value:.4g} units" if metres is None else f"{100.0 * metres * value:.3f} cm"


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
