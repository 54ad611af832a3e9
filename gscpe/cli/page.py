# SPDX-License-Identifier: Apache-2.0
"""The page of ``gscpe view``, and of ``--view`` elsewhere: its options, and how long it stays."""

from __future__ import annotations

import argparse
import webbrowser
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Iterator, Sequence

from gscpe.cli.streams import say
from gscpe.interrupts import Terminated
from gscpe.scene import Map

if TYPE_CHECKING:
    from gscpe.viewer import Live, Viewer

_LOCAL = ("127.0.0.1", "localhost", "::1")
_MOST_GAUSSIANS = 500_000


def add_page(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """``--host``, ``--port``, ``--open`` and ``--gaussians``."""
    parser.add_argument(
        "--gaussians",
        metavar="N",
        type=int,
        help=f"that are sent to the browser at most, the most visible (default: {_MOST_GAUSSIANS})",
    )
    parser.add_argument(
        "--host",
        help=f"address to listen at (default: {_LOCAL[0]}, this machine alone); there is no "
        "password: whoever reaches another address sees the map",
    )
    parser.add_argument("--port", type=int, help="(default: 8080, or the next that is free)")
    parser.add_argument(
        "--open",
        action=argparse.BooleanOptionalAction,
        help="open the page in the browser (default: yes)",
    )


def add_live(parser: argparse.ArgumentParser) -> None:
    """``--view`` and the options of its page."""
    page = parser.add_argument_group("a page in the browser")
    page.add_argument(
        "--view",
        action="store_true",
        help="show the map, and what is found, as it is found; the page stays after the end, "
        "until Ctrl-C",
    )
    add_page(page)


def check_page(options: argparse.Namespace) -> None:
    """Ends the program where the page's options make no sense."""
    if options.gaussians is not None and options.gaussians < 1:
        options.parser.error("--gaussians must be at least 1")
    if options.port is not None and not 0 < options.port < 65536:
        options.parser.error(f"--port {options.port} is not a port (1 to 65535)")


def check_live(options: argparse.Namespace) -> None:
    """As :func:`check_page`, and before any long work.

    Raises:
        MissingDependencyError: ``--view`` without viser.
    """
    if options.view:
        from gscpe.viewer.server import check_viser

        check_viser()
    else:
        for name in ("gaussians", "host", "port", "open"):
            value = getattr(options, name)
            if value is not None:
                given = "no-open" if value is False else name
                options.parser.error(f"--{given} goes with --view")
    check_page(options)


def page_settings(options: argparse.Namespace) -> dict[str, Any]:
    """What :class:`gscpe.viewer.Viewer` is told by the options."""
    return {
        "name": Path(options.map).name,
        "host": options.host or _LOCAL[0],
        "port": options.port,
        "most_gaussians": options.gaussians or _MOST_GAUSSIANS,
        "backend": options.backend,
    }


def open_page(options: argparse.Namespace, viewer: Viewer) -> None:
    """In the browser, with a warning where others may see it."""
    if options.host not in (None, *_LOCAL):
        say("whoever reaches this address sees the map and the photos: there is no password")
    if options.open is not False:
        webbrowser.open(viewer.url)


def stay(viewer: Viewer) -> None:
    """Until Ctrl-C, which is how one ends it."""
    try:
        viewer.wait()
    except Terminated:
        raise
    except KeyboardInterrupt:
        return


@contextmanager
def live_page(
    options: argparse.Namespace, map_: Map, photo_folders: Sequence[str | Path]
) -> Iterator[Live | None]:
    """The page that ``--view`` asks for; None where it was not given.

    Raises:
        GscpeError: as :class:`gscpe.viewer.Viewer`.
    """
    if not options.view:
        yield None
        return
    from gscpe.viewer import Live

    with Live(map_, photo_folders, **page_settings(options)) as live:
        # On standard error: what is printed may be read by programs.
        say(f"{live.viewer.url} shows what is found, as it is found")
        open_page(options, live.viewer)
        yield live


def stay_after(live: Live | None) -> None:
    """The page stays after the work, until Ctrl-C."""
    if live is not None:
        live.finish()
        say(f"finished; {live.viewer.url} stays until Ctrl-C")
        stay(live.viewer)
