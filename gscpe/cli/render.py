# SPDX-License-Identifier: Apache-2.0
"""``gscpe render``."""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path

import numpy as np

from gscpe.cli.common import CAMERA_HELP, Commands, add_backend, show_progress
from gscpe.errors import CameraError, OutputError
from gscpe.geometry.camera import Camera
from gscpe.localization.border import view_in_world
from gscpe.output_file import write_file
from gscpe.photos import write_image
from gscpe.poses.hloc import parse_pose
from gscpe.render import Renderer
from gscpe.render.pictures import depth_picture
from gscpe.scene import open_map


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("render", help="render the map at a pose")
    parser.add_argument("map", help="map folder, from gscpe build-map")
    parser.add_argument(
        "--pose", required=True, help="world to camera: 'qw qx qy qz tx ty tz', in quotes"
    )
    parser.add_argument("--camera", required=True, help=CAMERA_HELP)
    parser.add_argument(
        "--output",
        required=True,
        metavar="FOLDER",
        help="folder for rgb.png, depth.npy (world units), depth.png (coloured), opacity.png",
    )
    add_backend(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    cam_from_world, camera = parse_pose(options.pose), Camera.typed(options.camera)
    if not camera.is_pinhole:
        raise CameraError(
            "only pinhole cameras, without lens distortion, can be rendered: give PINHOLE,..."
        )
    folder = Path(options.output)
    if folder.suffix.lower() in (".png", ".jpg", ".jpeg"):
        raise OutputError(f"--output {folder} must be a folder, because several files are written")
    map_ = open_map(options.map)
    with Renderer(map_.scene, options.backend, show_progress()) as renderer:
        view = view_in_world(
            renderer.render(camera, map_.frame.cam_from_map(cam_from_world)), map_.frame
        )
    write_image(folder / "rgb.png", view.rgb)
    write_image(folder / "opacity.png", view.opacity)
    write_image(folder / "depth.png", depth_picture(view.depth))
    depth = io.BytesIO()
    np.save(depth, view.depth)
    write_file(folder / "depth.npy", depth.getvalue())
    if not np.any(view.opacity > 0.5):
        print(
            "the map is not visible at this pose; is the pose world to camera, as in COLMAP?",
            file=sys.stderr,
        )
    print(f"{folder}: rgb.png, depth.npy, depth.png, opacity.png")
    return 0
