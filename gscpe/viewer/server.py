# SPDX-License-Identifier: Apache-2.0
"""viser's web server, quiet, and for this machine alone."""

from __future__ import annotations

import contextlib
import io
from typing import TYPE_CHECKING

from gscpe.errors import MissingDependencyError, OutputError

if TYPE_CHECKING:
    import viser

FIRST_PORT = 8080


def check_viser() -> None:
    """Raises MissingDependencyError where viser is not installed."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            "the viewer needs viser: pip install 'gscpe[view]' (gscpe view --screenshot FILE "
            "does not)"
        ) from error


def start_server(host: str, port: int | None, label: str) -> viser.ViserServer:
    """A server that is listening.

    Args:
        host: address to listen at.
        port: to listen at; None: 8080, or the next one that is free.
        label: of the page's panel.

    Raises:
        MissingDependencyError: viser is not installed.
        OutputError: the port is taken, or the address is not of this machine.
    """
    check_viser()
    import viser

    class Server(viser.ViserServer):
        """Refuses viser's offer to make the page public through a server of its makers, which any
        page that is open in the browser could ask for."""

        def request_share_url(self, verbose: bool = True) -> str | None:
            return None

    try:
        # It prints what it is called, even if it is not verbose.
        with contextlib.redirect_stdout(io.StringIO()):
            server = Server(host, FIRST_PORT if port is None else port, label, verbose=False)
    except (OSError, RuntimeError) as error:
        raise OutputError(f"no server can listen at {host}: {error}") from error
    if port is not None and server.get_port() != port:
        stop_server(server)
        raise OutputError(f"port {port} is in use; give another --port, or none")
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    return server


def stop_server(server: viser.ViserServer) -> None:
    """Stops it, without a word."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()
