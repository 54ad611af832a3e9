"""``gscpe evaluate``."""

from __future__ import annotations

import argparse
import math

from gscpe.cli.common import Commands, print_json
from gscpe.evaluation import THRESHOLDS, evaluate
from gscpe.scene.pose_file import read_poses


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("evaluate", help="compare poses, in metres, with the truth")
    parser.add_argument("poses", help="estimates: name qw qx qy qz tx ty tz")
    parser.add_argument("truth", help="the same for all queries; a ninth number is ignored")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    result = evaluate(read_poses(options.poses), read_poses(options.truth))
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
            }
        )
        return 0
    print(f"localized        {result.localized} of {result.queries} photos of the truth list")
    if result.localized:
        print(f"median position  {100.0 * result.median_distance:.3f} cm")
        print(f"median rotation  {result.median_degrees:.3f} deg")
    for (metres, degrees), share in zip(THRESHOLDS, result.shares, strict=True):
        limit = f"{100 * metres:.0f} cm / {degrees:.0f} deg"
        print(f"within {limit:<15} {100.0 * share:5.1f} %")
    if result.localized < result.queries:
        print("photos without a pose count as beyond every limit")
    if result.ignored:
        print(f"{result.ignored} estimates are of photos that are not in the truth list")
    return 0


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
