# SPDX-License-Identifier: Apache-2.0
"""``gscpe convert-poses``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gscpe.batch import keep_a_copy
from gscpe.cli.common import Commands
from gscpe.errors import OutputError
from gscpe.given import real_path
from gscpe.poses import (
    COLMAP_FILES,
    POSE_FORMATS,
    complete_text_model,
    format_of_path,
    is_colmap_folder,
    photo_numbers,
    poses_by_name,
    read_pose_file,
    write_colmap_folder,
    write_pose_file,
)
from gscpe.scene.query_list import read_query_list


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser(
        "convert-poses", help="write a pose file in another form: hloc, pgt, colmap, tum, json"
    )
    parser.add_argument("input", help="pose file of any of the forms, or gscpe's details (.jsonl)")
    parser.add_argument(
        "output",
        help="images.txt or a folder (colmap; the folder holds a whole model, in binary), "
        ".txt (hloc), .tum or .json",
    )
    parser.add_argument(
        "--from",
        dest="from_format",
        choices=POSE_FORMATS,
        help="form of the input (default: detected from its first line)",
    )
    parser.add_argument(
        "--to",
        dest="to_format",
        choices=POSE_FORMATS,
        help="form of the output (default: from its file name)",
    )
    parser.add_argument(
        "--queries",
        metavar="LIST",
        help="all photos and their cameras, name MODEL width height params: focal lengths for "
        "pgt, camera ids for colmap, positions for tum; names for what is read from tum",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    same = real_path(options.input) == real_path(options.output)
    if same and not Path(options.input).is_dir():
        raise OutputError(f"{options.output} is also the input; choose another output")
    whole_model = is_colmap_folder(options.output, options.to_format)
    to_format = "colmap" if whole_model else options.to_format or format_of_path(options.output)
    file = read_pose_file(options.input, options.from_format)
    poses, cameras = file.poses, file.cameras or None
    if options.queries:
        cameras = {query.name: query.camera for query in read_query_list(options.queries)}
        if file.format == "tum":
            poses, _ = poses_by_name(poses, list(cameras))
    elif cameras is not None and not poses.keys() <= cameras.keys():
        cameras = None  # a file that tells only some cameras is no list of all photos
    output = Path(options.output)
    for path in [output / name for name in COLMAP_FILES] if whole_model else [output]:
        keep_a_copy(path, stays=True)
    if whole_model:
        write_colmap_folder(options.output, poses, cameras)
    else:
        write_pose_file(options.output, poses, to_format, cameras)
        if to_format == "colmap" and Path(options.output).name == "images.txt" and cameras:
            complete_text_model(options.output, poses, cameras)
    if to_format == "tum" and cameras is None and photo_numbers(list(poses)) is None:
        print(
            f"{options.input}: the photos are not named by timestamps, so their positions in "
            "this file are written, starting at 0; if the file lacks photos, give the whole list "
            "(--queries)",
            file=sys.stderr,
        )
    print(f"{options.output}: {len(poses)} poses, {file.format} to {to_format}")
    return 0
