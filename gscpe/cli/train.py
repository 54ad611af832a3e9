# SPDX-License-Identifier: Apache-2.0
"""``gscpe train``."""

from __future__ import annotations

import argparse
import sys
from contextlib import closing, nullcontext
from pathlib import Path

from gscpe.batch import keep_a_copy
from gscpe.cli.common import Commands, show_progress


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser(
        "train", help="make a splat from photos with known poses, on the CPU"
    )
    parser.add_argument(
        "--colmap",
        required=True,
        metavar="MODEL_DIR",
        help="COLMAP model with the photos' poses and points, for example model/sparse/0",
    )
    parser.add_argument("--images", required=True, metavar="IMAGE_DIR", help="the model's photos")
    parser.add_argument("--output", required=True, metavar="SPLAT", help=".ply (or .spz) to write")
    add_budget(parser)
    parser.add_argument("--resume", action="store_true", help="continue an interrupted training")
    parser.add_argument(
        "--max-size",
        metavar="PIXELS",
        type=int,
        default=1000,
        help="larger photos are shrunk until their longer side has this many pixels (default: "
        "%(default)s)",
    )
    parser.add_argument(
        "--masks",
        metavar="DIR",
        help="pictures named like the photos (NAME.png), black where these do not count",
    )
    parser.add_argument(
        "--test-every",
        metavar="N",
        type=int,
        default=8,
        help="leave out every N-th photo, to measure the quality of the splat; 0: train on all "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--sh-degree",
        type=int,
        default=3,
        help="degree of the colours' spherical harmonics, 0 to 3 (default: %(default)s)",
    )
    parser.add_argument(
        "--antialiased",
        action="store_true",
        help="train for rendering with the opacity compensation of Mip-Splatting",
    )
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    parser.set_defaults(run=run)


def add_budget(parser: argparse.ArgumentParser) -> None:
    """Options of the commands that train: how long, and how large the splat may become."""
    long = parser.add_mutually_exclusive_group()
    long.add_argument(
        "--minutes", type=float, default=20.0, help="of training (default: %(default)g)"
    )
    long.add_argument(
        "--iterations",
        type=int,
        help="of training, instead of minutes: the result is then the same on every run",
    )
    parser.add_argument(
        "--max-gaussians",
        metavar="N",
        type=int,
        default=250_000,
        help="of the splat (default: %(default)s)",
    )


def run(options: argparse.Namespace) -> int:
    from gscpe.training import ProgressBar, TrainingSettings, checkpoint_of, train_from_colmap

    by_time = options.iterations is None
    settings = TrainingSettings(
        iterations=TrainingSettings.iterations if by_time else options.iterations,
        minutes=options.minutes if by_time else None,
        max_gaussians=options.max_gaussians,
        sh_degree=options.sh_degree,
        antialiased=options.antialiased,
        seed=options.seed,
    )
    keep_a_copy(Path(options.output), stays=True)  # until the new splat replaces it
    try:
        with closing(ProgressBar()) if show_progress() else nullcontext() as bar:
            done = train_from_colmap(
                options.colmap,
                options.images,
                options.output,
                settings,
                options.max_size,
                options.test_every,
                resume=options.resume,
                progress=bar,
                masks=options.masks,
            )
    except KeyboardInterrupt:
        checkpoint = checkpoint_of(Path(options.output))
        if checkpoint.exists():
            print(f"{checkpoint}: continue from here with --resume", file=sys.stderr)
        raise
    which = f"{done.left_out} photos left out" if done.left_out else "photos trained on"
    print(
        f"{options.output}: {done.gaussians} Gaussians from {done.learned} photos in "
        f"{done.iterations} iterations; "
        f"PSNR of {which}: {done.likeness.psnr:.2f} dB, "
        f"{done.likeness.fitted_psnr:.2f} with gain and bias fitted"
    )
    return 0
