# SPDX-License-Identifier: Apache-2.0
"""``gscpe view``: a map in the browser, or as a picture."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from gscpe.batch import check_outputs
from gscpe.cli.common import Commands, add_backend
from gscpe.cli.streams import say
from gscpe.errors import OutputError
from gscpe.interrupts import Terminated
from gscpe.scene import open_map, write_image

_LOCAL = ("127.0.0.1", "localhost", "::1")
_MOST_GAUSSIANS = 500_000


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
        help="write a picture from behind and above instead, without a browser",
    )
    parser.add_argument(
        "--gaussians",
        metavar="N",
        type=int,
        default=_MOST_GAUSSIANS,
        help="that are sent to the browser at most, the most visible (default: %(default)s)",
    )
    parser.add_argument(
        "--host",
        default=_LOCAL[0],
        help="address to listen at (default: %(default)s, this machine alone); there is no "
        "password: whoever reaches another address sees the map",
    )
    parser.add_argument("--port", type=int, help="(default: 8080, or the next that is free)")
    parser.add_argument(
        "--open",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="open the page in the browser (default: yes)",
    )
    add_backend(parser)
    parser.set_defaults(run=run, parser=parser)


def run(options: argparse.Namespace) -> int:
    from gscpe.viewer import Viewer, contents_of, overview, read_findings
    from gscpe.viewer.photos import Photos
    from gscpe.viewer.server import check_viser

    if options.gaussians < 1:
        options.parser.error("--gaussians must be at least 1")
    if options.port is not None and not 0 < options.port < 65536:
        options.parser.error(f"--port {options.port} is not a port (1 to 65535)")
    inputs = [options.poses, options.details, options.truth, options.trajectory]
    if options.screenshot is None:
        check_viser()
    else:
        if Path(options.screenshot).is_dir():
            raise OutputError(f"--screenshot {options.screenshot} is a folder; give a file")
        check_outputs([options.screenshot], [path for path in inputs if path is not None])
    findings = read_findings(*inputs)
    map_ = open_map(options.map)
    contents = contents_of(map_, findings)
    if options.screenshot is not None:
        picture = overview(map_, contents, photos=Photos(options.images), backend=options.backend)
        write_image(options.screenshot, picture)
        print(f"{options.screenshot}: the map with {len(contents.cameras)} cameras")
        return 0
    with Viewer(
        *(map_, contents, options.images),
        name=Path(options.map).name,
        host=options.host,
        port=options.port,
        most_gaussians=options.gaussians,
        backend=options.backend,
    ) as viewer:
        print(f"{viewer.url} shows the map; Ctrl-C ends it", flush=True)
        if options.host not in _LOCAL:
            say("whoever reaches this address sees the map and the photos: there is no password")
        if options.open:
            webbrowser.open(viewer.url)
        try:
            viewer.wait()
        except Terminated:
            raise
        except KeyboardInterrupt:
            return 0  # how one ends it
    return 0
