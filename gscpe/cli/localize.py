# SPDX-License-Identifier: Apache-2.0
"""``gscpe localize``: one photo, or a list of them."""

from __future__ import annotations

import argparse
from pathlib import Path

from gscpe.batch import MAPS_TRIED
from gscpe.cli.common import (
    CAMERA_HELP,
    Commands,
    add_localizing,
    add_timeout,
    add_workers,
)
from gscpe.cli.localize_list import localize_queries
from gscpe.cli.localize_photo import localize_photo
from gscpe.cli.page import add_live, check_live
from gscpe.localization import PosePrior


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("localize", help="find where one photo, or many, were taken")
    parser.add_argument("map", help="map folder, from gscpe build-map")
    parser.add_argument("photo", nargs="?", help="one photo")
    parser.add_argument(
        "--camera",
        help=f"camera of the photo, or of all listed photos without one: {CAMERA_HELP}. Without "
        "it, the camera of a single photo, or one for a whole folder of photos, is estimated; a "
        "fisheye must be given",
    )
    parser.add_argument(
        "--json", action="store_true", help="print everything about the one photo as JSON"
    )
    parser.add_argument(
        "--also",
        metavar="MAP",
        action="append",
        help="another map to look in; may be repeated: for each photo, the maps with the most "
        f"similar reference photos, {MAPS_TRIED} at most, are opened, until it is found. Of a "
        "list, the poses in each map get files of their own: poses.MAP.txt",
    )
    parser.add_argument(
        "--memory",
        metavar="GB",
        type=float,
        help="with --also: maps that are held at a time, at most, by each worker (default: all "
        "that are opened)",
    )
    parser.add_argument(
        "--prior",
        metavar="POSE",
        help='approximate pose of the one photo: "qw qx qy qz tx ty tz", world to camera',
    )
    parser.add_argument(
        "--prior-sigma",
        nargs=2,
        type=float,
        metavar=("LENGTH", "DEGREES"),
        help="standard deviations of the prior, or of all priors, in world units and degrees; with "
        "180 degrees, only the position is used "
        f"(default: {PosePrior.translation_sigma} {PosePrior.rotation_sigma_degrees})",
    )
    parser.add_argument(
        "--pictures",
        metavar="DIR",
        help="write photo, render and their difference side by side, a picture a photo",
    )
    _add_many(parser)
    add_live(parser)
    add_localizing(parser)
    parser.set_defaults(run=run, parser=parser)


def _add_many(parser: argparse.ArgumentParser) -> None:
    """Options of lists of photos."""
    many = parser.add_argument_group("many photos")
    many.add_argument(
        "--queries",
        metavar="FILE",
        help="lines of: name MODEL width height params; or of names alone, with --camera",
    )
    many.add_argument(
        "--images",
        metavar="QUERY_DIR",
        help="folder of the query photos; without --queries, all photos in it: of one camera, "
        "given or estimated",
    )
    many.add_argument("--output", metavar="POSES", help="poses: name qw qx qy qz tx ty tz")
    many.add_argument(
        "--coarse-output", metavar="POSES", help="the coarse poses, from matches alone"
    )
    many.add_argument(
        "--details",
        metavar="JSONL",
        help="one line per query with everything that is known (default: beside the output)",
    )
    many.add_argument(
        "--resume",
        action="store_true",
        help="continue an interrupted run: keep what the details already hold",
    )
    many.add_argument(
        "--priors",
        metavar="POSES",
        help="approximate poses: a file in any form that gscpe evaluate reads; photos that it "
        "lacks are localized without a prior",
    )
    add_workers(many)
    add_timeout(many)


def run(options: argparse.Namespace) -> int:
    parser: argparse.ArgumentParser = options.parser
    listed = options.queries is not None or (options.photo is None and options.images is not None)
    if (options.photo is None) != listed:
        parser.error("give either one photo, or many: --queries with --images, or --images alone")
    one = {"json", "prior"}
    many = {
        *("images", "output", "coarse_output", "details"),
        *("resume", "priors", "workers", "scheduler", "timeout"),
    }
    alien = sorted(name for name in (one if listed else many) if getattr(options, name))
    if alien:
        option = "--" + alien[0].replace("_", "-")
        parser.error(f"{option} cannot be used with {'many photos' if listed else 'a photo'}")
    check_live(options)
    _check_several(options)
    if not listed:
        if Path(options.photo).is_dir():
            parser.error(f"{options.photo} is a folder; give it as --images")
        return localize_photo(options)
    if options.images is None or options.output is None:
        parser.error("many photos need --images and --output")
    return localize_queries(options)


def _check_several(options: argparse.Namespace) -> None:
    parser: argparse.ArgumentParser = options.parser
    if options.also is None:
        if options.memory is not None:
            parser.error("--memory needs --also")
        return
    for name in ("prior", "priors"):
        if getattr(options, name) is not None:
            parser.error(f"--{name} belongs to one map, and --also names others")
    if options.view:
        parser.error("--view shows one map, and --also names others")
