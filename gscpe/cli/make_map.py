# SPDX-License-Identifier: Apache-2.0
"""``gscpe make-map``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gscpe.cli.common import Commands, add_backend, show_progress
from gscpe.cli.reconstruct import add_reconstruction, reconstruction_settings, report_not_placed
from gscpe.errors import InputError, SettingsError

if TYPE_CHECKING:
    from gscpe.making import KnownPoses
    from gscpe.reconstruction import Reconstruction


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("make-map", help="make a map from photos or a video, on the CPU")
    parser.add_argument(
        "source", nargs="+", metavar="PHOTOS_OR_VIDEO", help="folder of photos, or videos"
    )
    parser.add_argument("--output", required=True, metavar="MAP", help="map folder to write")
    known = parser.add_argument_group("where the photos' poses are known")
    known.add_argument(
        "--colmap", metavar="MODEL_DIR", help="COLMAP model of the photos, for example sparse/0"
    )
    known.add_argument(
        "--poses", metavar="FILE", help="poses of the photos, in any form that gscpe reads"
    )
    known.add_argument(
        "--cameras",
        metavar="LIST",
        help="with --poses: name MODEL width height params, a line each",
    )
    known.add_argument(
        "--metres-per-unit",
        metavar="METRES",
        type=float,
        help="length of a unit of these poses (default: not known)",
    )
    add_reconstruction(parser)
    long = parser.add_mutually_exclusive_group()
    long.add_argument(
        "--minutes", type=float, default=20.0, help="of training (default: %(default)g)"
    )
    long.add_argument(
        "--iterations", type=int, help="of training, instead: the same result every time"
    )
    parser.add_argument(
        "--max-gaussians", metavar="N", type=int, default=250_000, help="(default: %(default)s)"
    )
    parser.add_argument(
        "--test-every",
        metavar="N",
        type=int,
        default=8,
        help="one photo of N is left out, and localized in the finished map to tell how good that "
        "is; 0 for none (default: %(default)s)",
    )
    parser.add_argument("--resume", action="store_true", help="go on where a run was interrupted")
    add_backend(parser)
    parser.set_defaults(run=run, parser=parser)


def run(options: argparse.Namespace) -> int:
    from gscpe.evaluation.table import to_text
    from gscpe.making import MakeMapSettings, make_map, summary_table, work_folder_of
    from gscpe.reconstruction import ScaleSource

    settings = MakeMapSettings(
        reconstruction=reconstruction_settings(options),
        minutes=options.minutes,
        iterations=options.iterations,
        max_gaussians=options.max_gaussians,
        test_every=options.test_every,
        seed=options.seed,
    )
    try:
        made = make_map(
            _known(options) or options.source,
            options.output,
            settings,
            ScaleSource.parse(options.scale_from),
            options.masks,
            options.resume,
            options.backend,
            show_progress(),
            _placed,
        )
    except KeyboardInterrupt:
        work = work_folder_of(options.output)
        if work.exists():
            print(f"{work}: go on from here with --resume", file=sys.stderr)
        raise
    if made.certificate is not None:
        print(to_text([summary_table(made.certificate)]))
        print(made.certificate.explanation())
        print(f"{made.page}: the certificate, with pictures")
    print(f"{made.folder}: {made.gaussians} Gaussians, {made.references} reference photos")
    return 0


def _placed(result: Reconstruction) -> None:
    print(result, flush=True)
    report_not_placed(result)


def _known(options: argparse.Namespace) -> KnownPoses | None:
    """Raises InputError where a pose file or its cameras cannot be read."""
    from gscpe.making import KnownPoses

    if options.colmap is None and options.poses is None:
        if options.metres_per_unit is not None or options.cameras is not None:
            options.parser.error("--metres-per-unit and --cameras go with --colmap or --poses")
        return None
    if options.colmap is not None and options.poses is not None:
        options.parser.error("give --colmap or --poses, not both")
    if (options.poses is None) != (options.cameras is None):
        options.parser.error("--poses and --cameras go together")
    if options.metres_per_unit is not None and not 0 < options.metres_per_unit < float("inf"):
        raise SettingsError(f"metres per unit must be positive, not {options.metres_per_unit}")
    folder = Path(options.source[0])
    if len(options.source) != 1 or not folder.is_dir():
        raise InputError("photos with known poses are given as one folder")
    if options.colmap is not None:
        return KnownPoses(folder, Path(options.colmap), metres_per_unit=options.metres_per_unit)
    from gscpe.scene.poses import read_pose_file
    from gscpe.scene.query_list import read_query_list

    cameras = {q.name: q.camera for q in read_query_list(options.cameras, image_folder=folder)}
    poses = read_pose_file(options.poses).poses
    return KnownPoses(folder, None, poses, cameras, options.metres_per_unit)
