# SPDX-License-Identifier: Apache-2.0
"""``gscpe reconstruct``."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from gscpe.cli.common import Commands, show_progress
from gscpe.cli.known_poses import add_known_poses, known_poses, refinement_settings
from gscpe.errors import SettingsError

if TYPE_CHECKING:
    from gscpe.reconstruction import Reconstruction, ReconstructionSettings

_NAMED = 10


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser(
        "reconstruct",
        help="find the poses of photos or of a video's frames (structure from motion), or refine "
        "poses that are known roughly",
    )
    parser.add_argument(
        "source", nargs="+", metavar="PHOTOS_OR_VIDEO", help="folder of photos, or videos"
    )
    parser.add_argument(
        "--output",
        required=True,
        metavar="FOLDER",
        help="to write: sparse/0, the COLMAP model; images, its photos; reconstruction.json",
    )
    add_known_poses(parser)
    add_reconstruction(parser)
    parser.add_argument("--resume", action="store_true", help="go on where a run was interrupted")
    parser.set_defaults(run=run, parser=parser)


def add_reconstruction(parser: argparse.ArgumentParser) -> None:
    """Options of the commands that put photos together."""
    parser.add_argument(
        "--max-size",
        metavar="PIXELS",
        type=int,
        default=1000,
        help="photos with a longer side are shrunk to this (default: %(default)s)",
    )
    parser.add_argument(
        "--frames",
        metavar="N",
        type=int,
        default=200,
        help="at most so many frames are taken of videos (default: %(default)s)",
    )
    parser.add_argument(
        "--scale-from",
        metavar="WHAT",
        help="where the unit comes from: gps (the photos' EXIF), FILE with known poses of some "
        "photos, distance:PHOTO,PHOTO,METRES between two cameras, points:FILE with lengths of "
        "things that photos show (see docs/making-maps.md), or depth:FOLDER of 16-bit depth "
        "images, named like the photos, in millimetres (depth:FOLDER,5000 where a metre is 5000); "
        "else the map's unit is not known",
    )
    parser.add_argument(
        "--masks",
        metavar="DIR",
        help="pictures named like the photos (NAME.png), black where these do not count",
    )
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")


def reconstruction_settings(options: argparse.Namespace) -> ReconstructionSettings:
    """What :func:`add_reconstruction` was told."""
    from gscpe.reconstruction import ReconstructionSettings

    return ReconstructionSettings(
        max_size=options.max_size,
        frames=options.frames,
        seed=options.seed,
    )


def run(options: argparse.Namespace) -> int:
    try:
        result = _reconstruct(options)
    except KeyboardInterrupt:
        print(f"{options.output}: go on from here with --resume", file=sys.stderr)
        raise
    print(f"{options.output}: {result}")
    report_not_placed(result)
    return 0


def _reconstruct(options: argparse.Namespace) -> Reconstruction:
    from gscpe.reconstruction import ScaleSource, reconstruct, refine_known_poses

    known, settings = known_poses(options), reconstruction_settings(options)
    scale = ScaleSource.parse(options.scale_from)
    masks, resume, progress = options.masks, options.resume, show_progress()
    if known is None:
        return reconstruct(
            *(options.source, options.output, settings, scale, masks),
            resume=resume,
            progress=progress,
        )
    if scale.kind != "unknown":
        raise SettingsError("known poses have a scale: give --metres-per-unit, and no --scale-from")
    refinement = refinement_settings(options)
    return refine_known_poses(
        *(known, options.output, settings, refinement, masks), resume=resume, progress=progress
    )


def report_not_placed(result: Reconstruction) -> None:
    """Names the photos without a pose, and why."""
    for names in result.other_models:
        print(
            f"{len(names)} photos hang together among themselves alone, from {names[0]} to "
            f"{names[-1]}",
            file=sys.stderr,
        )
    apart = {name for names in result.other_models for name in names}
    lone = {name: why for name, why in result.not_placed.items() if name not in apart}
    for name, why in list(lone.items())[:_NAMED]:
        print(f"not placed: {name} {why}", file=sys.stderr)
    if len(lone) > _NAMED:
        print(f"not placed: {len(lone) - _NAMED} more, see reconstruction.json", file=sys.stderr)
