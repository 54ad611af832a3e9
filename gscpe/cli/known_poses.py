# SPDX-License-Identifier: Apache-2.0
"""Options of the commands that take photos whose poses are known."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from gscpe.errors import InputError, SettingsError

if TYPE_CHECKING:
    from gscpe.reconstruction import KnownPoses, PoseRefinementSettings


def add_known_poses(parser: argparse.ArgumentParser, refine: str | None = None) -> None:
    """Adds them.

    Args:
        parser: of the command; it is found again in its options, as ``parser``.
        refine: name of the flag that the poses are to be refined; None where they always are.
    """
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
    scale = known.add_mutually_exclusive_group()
    scale.add_argument(
        "--metres-per-unit",
        metavar="METRES",
        type=float,
        help="length of a unit of these poses in metres (default: 1)",
    )
    scale.add_argument(
        "--unknown-scale",
        action="store_true",
        help="the poses are not metric, as those of structure from motion are not",
    )
    if refine is not None:
        known.add_argument(
            refine,
            action="store_true",
            help="the poses are off by some pixels, as those of devices are: refine them by what "
            "the photos show",
        )
    known.add_argument(
        "--refine-focal-length",
        action="store_true",
        help="refine the focal lengths of the cameras, too",
    )


def known_poses(options: argparse.Namespace) -> KnownPoses | None:
    """What was told; None where nothing was.

    Raises:
        InputError: a pose file or its cameras cannot be read; there is no folder of photos.
        SettingsError: the length of a unit is impossible.
    """
    from gscpe.reconstruction import KnownPoses

    refine = getattr(options, "refine_poses", True)
    if options.colmap is None and options.poses is None:
        if (options.metres_per_unit, options.cameras, options.unknown_scale) != (None, None, False):
            options.parser.error(
                "--metres-per-unit, --unknown-scale and --cameras go with --colmap or --poses"
            )
        if options.refine_focal_length or (refine and hasattr(options, "refine_poses")):
            options.parser.error("only known poses are refined: give --colmap or --poses")
        return None
    if options.colmap is not None and options.poses is not None:
        options.parser.error("give --colmap or --poses, not both")
    if (options.poses is None) != (options.cameras is None):
        options.parser.error("--poses and --cameras go together")
    if options.refine_focal_length and not refine:
        options.parser.error("--refine-focal-length goes with --refine-poses")
    unit = 1.0 if options.metres_per_unit is None else options.metres_per_unit
    if not 0 < unit < float("inf"):
        raise SettingsError(f"metres per unit must be positive, not {unit}")
    unit = None if options.unknown_scale else unit
    folder = Path(options.source[0])
    if len(options.source) != 1 or not folder.is_dir():
        raise InputError("photos with known poses are given as one folder")
    if options.colmap is not None:
        return KnownPoses(folder, Path(options.colmap), metres_per_unit=unit)
    from gscpe.poses import read_pose_file
    from gscpe.scene.query_list import read_query_list

    cameras = {q.name: q.camera for q in read_query_list(options.cameras, image_folder=folder)}
    poses = read_pose_file(options.poses).poses
    return KnownPoses(folder, None, poses, cameras, unit)


def refinement_settings(options: argparse.Namespace) -> PoseRefinementSettings:
    """What :func:`add_known_poses` was told."""
    from gscpe.reconstruction import PoseRefinementSettings

    return PoseRefinementSettings(refine_focal_length=options.refine_focal_length)
