# SPDX-License-Identifier: Apache-2.0
"""``gscpe make-map``."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from gscpe.cli.common import Commands, add_backend, show_progress
from gscpe.cli.known_poses import add_known_poses, known_poses, refinement_settings
from gscpe.cli.reconstruct import add_reconstruction, reconstruction_settings, report_not_placed
from gscpe.cli.train import add_budget

if TYPE_CHECKING:
    from gscpe.reconstruction import Reconstruction


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("make-map", help="make a map from photos or a video, on the CPU")
    parser.add_argument(
        "source", nargs="+", metavar="PHOTOS_OR_VIDEO", help="folder of photos, or videos"
    )
    parser.add_argument("--output", required=True, metavar="MAP", help="map folder to write")
    add_known_poses(parser, "--refine-poses")
    add_reconstruction(parser)
    add_budget(parser)
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
    refinement = refinement_settings(options) if options.refine_poses else None
    try:
        made = make_map(
            known_poses(options) or options.source,
            options.output,
            settings,
            ScaleSource.parse(options.scale_from),
            options.masks,
            resume=options.resume,
            backend=options.backend,
            progress=show_progress(),
            reconstructed=_placed,
            refinement=refinement,
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
