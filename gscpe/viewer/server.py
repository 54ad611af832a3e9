# SPDX-License-Identifier: Apache-2.0
"""viser's web server, quiet, and for this machine alone."""

from __future__ import annotations

import contextlib
import errno
import io
import socket
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
    _check_address(host, port)
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
        raise OutputError(_in_use(port))
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    return server


def page_url(host: str, port: int) -> str:
    """Where a browser at this machine finds the page."""
    if host in ("0.0.0.0", "::"):  # every address of this machine
        host = "localhost"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _check_address(host: str, port: int | None) -> None:
    """Listens there for a moment: viser waits for ever where it cannot.

    Raises:
        OutputError: the port is taken, or the address is not of this machine.
    """
    try:
        found = socket.getaddrinfo(host, port or 0, type=socket.SOCK_STREAM)
        for family, kind, protocol, _, address in found:
            with socket.socket(family, kind, protocol) as probe:
                # As viser does: what was closed a moment ago is free.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                probe.bind(address)
    except (OSError, UnicodeError) as error:
        if port is not None and getattr(error, "errno", None) == errno.EADDRINUSE:
            raise OutputError(_in_use(port)) from error
        at = host if port is None else f"{host} port {port}"
        reason = getattr(error, "strerror", None) or str(error)
        raise OutputError(f"no page can be served at {at}: {reason}") from error


def _in_use(port: int) -> str:
    return f"port {port} is in use; give another --port, or none"


def stop_server(server: viser.ViserServer) -> None:
    """Stops it, without a word."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()
