"""``gscpe evaluate``."""

from __future__ import annotations

import argparse
import math
import sys

from gscpe.arrays import Float64Array
from gscpe.cli.common import Commands, print_json
from gscpe.errors import SettingsError
from gscpe.evaluation import THRESHOLDS, evaluate
from gscpe.scene.poses import PoseFile, poses_by_name, read_pose_file


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("evaluate", help="compare poses, in metres, with the truth")
    parser.add_argument("poses", help="estimates: a pose file of any form, see docs/formats.md")
    parser.add_argument("truth", help="the true poses of all queries, of any form too")
    parser.add_argument(
        "--metres-per-unit",
        type=float,
        default=1.0,
        metavar="METRES",
        help="length of a unit of both files in metres (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    unit = options.metres_per_unit
    if not (math.isfinite(unit) and unit > 0):
        raise SettingsError(f"--metres-per-unit must be positive, not {unit:g}")
    estimates = read_pose_file(options.poses, keep_not_finite=True)
    truth = read_pose_file(options.truth)
    estimated, known, by_position = _with_common_names(estimates, truth)
    result = evaluate(estimated, known, unit)
    if options.json:
        print_json(
            {
                "queries": result.queries,
                "localized": result.localized,
                "median_position_m": _number(result.median_distance),
                "median_rotation_degrees": _number(result.median_degrees),
                "within": [
                    {"position_m": metres, "rotation_degrees": degrees, "share": share}
                    for (metres, degrees), share in zip(THRESHOLDS, result.shares, strict=True)
                ],
                "not_in_truth": result.ignored,
                "not_finite": len(estimates.not_finite),
                "metres_per_unit": unit,
                "matched_by_position": by_position,
            }
        )
        return 0
    print(f"localized        {result.localized} of {result.queries} photos of the truth list")
    if result.localized:
        of = "" if result.localized == result.queries else f" (of these {result.localized})"
        print(f"median position  {100.0 * result.median_distance:.3f} cm{of}")
        print(f"median rotation  {result.median_degrees:.3f} deg{of}")
    for (metres, degrees), share in zip(THRESHOLDS, result.shares, strict=True):
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
            f"{options.poses} holds {len(estimated)} poses for {len(known)} photos. Its timestamps "
            "were taken as positions in the truth list, from 0; if they count the poses of the "
            "file, all errors above are wrong",
            file=sys.stderr,
        )
    elif by_position:
        print("timestamps were taken as positions in the truth list, from 0")
    return 0


def _with_common_names(
    estimates: PoseFile, truth: PoseFile
) -> tuple[dict[str, Float64Array], dict[str, Float64Array], bool]:
    """Estimates and truth under the same names, where one or both are TUM's; whether
    timestamps were taken as positions."""
    if "tum" not in (estimates.format, truth.format) or not (estimates.poses and truth.poses):
        return estimates.poses, truth.poses, False
    if estimates.format == "tum":
        named, how = poses_by_name(estimates.poses, list(truth.poses))
        return named, truth.poses, how == "position"
    # Photos may lack an estimate, so positions among the estimates say nothing.
    named, _ = poses_by_name(truth.poses, list(estimates.poses), by_position=False)
    return estimates.poses, named, False


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
