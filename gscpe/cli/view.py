# SPDX-License-Identifier: Apache-2.0
"""``gscpe view``: a map in the browser, or as a picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from gscpe.batch import check_outputs, named_maps
from gscpe.cli.common import Commands, add_backend
from gscpe.cli.page import add_page, check_page, open_page, page_settings, stay
from gscpe.errors import OutputError
from gscpe.photos import write_image
from gscpe.scene import open_map


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser(
        "view", help="look at a map, its photos and localized poses in a browser"
    )
    parser.add_argument("map", help="map folder, from gscpe build-map or make-map")
    parser.add_argument(
        "--poses", metavar="POSES", help="localized poses, in any form that gscpe evaluate reads"
    )
    parser.add_argument(
        "--details",
        metavar="JSONL",
        help="what gscpe localize wrote of each photo: coarse and aligned poses, covariances, "
        "reasons (default: beside the poses, if it is there)",
    )
    parser.add_argument("--truth", metavar="POSES", help="true poses")
    parser.add_argument("--trajectory", metavar="TUM", help="of gscpe track: time tx ty tz ...")
    parser.add_argument(
        "--images",
        metavar="DIR",
        nargs="+",
        default=[],
        help="folders with the reference photos and the localized ones",
    )
    parser.add_argument(
        "--screenshot",
        metavar="PNG",
        help="write a picture of what the page would show first instead, without a browser",
    )
    add_page(parser)
    add_backend(parser)
    parser.set_defaults(run=run, parser=parser)


def run(options: argparse.Namespace) -> int:
    from gscpe.viewer import Viewer, contents_of, overview, read_findings
    from gscpe.viewer.photos import Photos
    from gscpe.viewer.server import check_viser

    check_page(options)
    inputs = (options.poses, options.details, options.truth, options.trajectory)
    if options.screenshot is None:
        check_viser()
    else:
        if Path(options.screenshot).is_dir():
            raise OutputError(f"--screenshot {options.screenshot} is a folder; give a file")
        check_outputs([options.screenshot], [path for path in inputs if path is not None])
    (name,) = named_maps([options.map])
    findings = read_findings(*inputs, map_name=name)
    map_ = open_map(options.map)
    contents = contents_of(map_, findings)
    if options.screenshot is not None:
        picture = overview(map_, contents, photos=Photos(options.images), backend=options.backend)
        write_image(options.screenshot, picture)
        count = len(contents.cameras)
        print(f"{options.screenshot}: the map with {count} camera{'s' * (count != 1)}")
        return 0
    with Viewer(map_, contents, options.images, **page_settings(options)) as viewer:
        print(f"{viewer.url} shows the map; Ctrl-C ends it", flush=True)
        open_page(options, viewer)
        stay(viewer)
    return 0
