# SPDX-License-Identifier: Apache-2.0
"""``gscpe demo``."""

from __future__ import annotations

import argparse
from typing import Any

from gscpe.cli.common import Commands, add_backend, add_matcher, print_json, show_progress
from gscpe.demo import DemoReport, run_demo
from gscpe.geometry.pose_error import PoseDifference
from gscpe.poses.hloc import format_pose


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser(
        "demo", help="localize a real photo with a known answer, without a download"
    )
    parser.add_argument(
        "--output", default="gscpe-demo", help="folder for the pictures (default: %(default)s)"
    )
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")
    add_matcher(parser)
    add_backend(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    report = run_demo(options.output, options.backend, show_progress(), options.matcher)
    if options.json:
        print_json(_as_json(report))
    else:
        _print_text(report)
    return 0


def _as_json(report: DemoReport) -> dict[str, Any]:
    coarse, aligned = report.result.coarse, report.result.aligned
    assert coarse is not None and aligned is not None
    assert coarse.cam_from_world is not None and aligned.cam_from_world is not None

    def stage(cam_from_world: Any, error: PoseDifference) -> dict[str, Any]:
        return {
            "cam_from_world": format_pose(cam_from_world),
            "error_mm": error.distance * 1000.0,
            "error_degrees": error.degrees,
        }

    return {
        "renderer": report.renderer,
        "gaussians": report.gaussians,
        "true_cam_from_world": format_pose(report.true_cam_from_world),
        "coarse": stage(coarse.cam_from_world, report.coarse_error)
        | {"matches": coarse.matches, "inliers": coarse.inliers},
        "aligned": stage(aligned.cam_from_world, report.aligned_error)
        | {"agreement": aligned.agreement, "residual": aligned.residual},
        "final": stage(report.result.cam_from_world, report.final_error),
        "seconds": report.seconds,
        "pictures": {name: str(path) for name, path in report.pictures.items()},
    }


def _print_text(report: DemoReport) -> None:
    data = _as_json(report)
    print("Where was the right photo of the Middlebury Motorcycle pair taken?")
    print(f"Map: {report.gaussians} Gaussians made of the left photo and its depth")
    print(f"Renderer: {report.renderer}")
    print()
    print("pose     qw qx qy qz tx ty tz (world to camera)")
    for name in ("coarse", "aligned", "final"):
        print(f"{name:<8} {_short(data[name]['cam_from_world'])}")
    print(f"{'true':<8} {_short(data['true_cam_from_world'])}")
    print()
    print("error      position   rotation")
    for name in ("coarse", "aligned", "final"):
        stage = data[name]
        print(f"{name:<8} {stage['error_mm']:8.3f} mm {stage['error_degrees']:9.5f} deg")
    print()
    print(
        "seconds:  " + ", ".join(f"{name} {value:.2f}" for name, value in data["seconds"].items())
    )
    print()
    print("pictures:")
    for name, path in data["pictures"].items():
        print(f"  {path}  {name}")


def _short(pose: str) -> str:
    return " ".join(f"{float(number):.6f}" for number in pose.split())
