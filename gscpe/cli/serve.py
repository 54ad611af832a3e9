# SPDX-License-Identifier: Apache-2.0
"""``gscpe serve``: poses over HTTP."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from gscpe.batch import ShelfOrder
from gscpe.cli.common import (
    Commands,
    add_localizing,
    positive,
    shelf_order_of,
)
from gscpe.errors import SettingsError
from gscpe.service.limits import Limits

if TYPE_CHECKING:
    from gscpe.service.service import ServiceSettings


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser(
        "serve", help="answer photos with poses over HTTP, with a page for phones"
    )
    parser.add_argument(
        "maps", nargs="+", metavar="MAP", help="map folders; each is served by its folder's name"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address (default: this machine alone)")
    parser.add_argument("--port", type=int, default=8000, help="default: 8000; 0: any that is free")
    parser.add_argument(
        "--token-file",
        metavar="FILE",
        help="requests must bear the token in this file; needed for any other address than this "
        "machine's",
    )
    parser.add_argument(
        "--insecure", action="store_true", help="another address, and no token: for everybody"
    )
    parser.add_argument("--certificate", metavar="FILE", help="for https, with --key")
    parser.add_argument("--key", metavar="FILE", help="of the certificate")
    _add_limits(parser)
    add_localizing(parser)
    parser.set_defaults(run=run, parser=parser)


def _add_limits(parser: argparse.ArgumentParser) -> None:
    """How much is done at a time, and how much a request may ask for."""
    parser.add_argument(
        "--workers",
        metavar="N",
        type=positive,
        help="processes that localize, which share the cores (default: chosen for this machine)",
    )
    parser.add_argument(
        "--memory",
        metavar="GB",
        type=float,
        help="maps that a worker holds at a time, at most; the others are opened when they are "
        "asked for (default: all are held)",
    )
    parser.add_argument(
        "--queue",
        metavar="N",
        type=positive,
        default=Limits.queue,
        help=f"requests at a time; more are answered with 503 (default: {Limits.queue})",
    )
    parser.add_argument(
        "--timeout",
        metavar="SECONDS",
        type=positive,
        default=int(Limits.seconds),
        help="a worker that gives no sign of life for so long (it gives one at each step of its "
        "work) is replaced, and the photo is tried once more "
        f"(default: {Limits.seconds:g})",
    )
    parser.add_argument(
        "--max-body",
        metavar="MB",
        type=positive,
        default=Limits.body_bytes // 1_000_000,
        help=f"of a request, in megabytes (default: {Limits.body_bytes // 1_000_000})",
    )
    parser.add_argument(
        "--max-pixels",
        metavar="MILLIONS",
        type=positive,
        default=Limits.pixels // 1_000_000,
        help=f"of a photo (default: {Limits.pixels // 1_000_000})",
    )
    parser.add_argument(
        "--trackers",
        metavar="N",
        type=int,
        default=Limits.trackers,
        help="cameras that are followed at a time, a process each "
        f"(default: {Limits.trackers}; 0: none)",
    )


def run(options: argparse.Namespace) -> int:
    from gscpe.service.server import require_packages

    require_packages()
    from gscpe.service.access import check_exposure, read_token
    from gscpe.service.server import listen, make_server
    from gscpe.service.service import Service

    if (options.certificate is None) != (options.key is None):
        raise SettingsError("give --certificate and --key together")
    token = None if options.token_file is None else read_token(options.token_file)
    check_exposure(options.host, token, options.insecure)
    order = shelf_order_of(options, options.maps)
    settings = _settings(options, token, order)
    with listen(options.host, options.port) as socket, Service(order, settings) as service:
        server = make_server(service, options.certificate, options.key)
        host, port = socket.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        scheme = "http" if options.certificate is None else "https"
        print(
            f"gscpe serve: {scheme}://{shown}:{port}, maps: {', '.join(service.maps)}; "
            f"{service.staff.description}",
            file=sys.stderr,
            flush=True,
        )
        try:
            server.run(sockets=[socket])
        except KeyboardInterrupt:  # what is running was finished before it was raised
            print("gscpe serve: ended", file=sys.stderr)
    return 0


def _settings(options: argparse.Namespace, token: str | None, order: ShelfOrder) -> ServiceSettings:
    from gscpe.service.service import ServiceSettings, choose_service_workers

    limits = Limits(
        body_bytes=1_000_000 * options.max_body,
        pixels=1_000_000 * options.max_pixels,
        seconds=float(options.timeout),
        queue=options.queue,
        trackers=options.trackers,
    )
    workers = options.workers or choose_service_workers(order)
    return ServiceSettings(options.host, token, options.insecure, workers, limits)
