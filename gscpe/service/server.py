# SPDX-License-Identifier: Apache-2.0
"""Runs a service until a signal ends it (uvicorn)."""

from __future__ import annotations

import math
import socket
from pathlib import Path
from typing import TYPE_CHECKING

from gscpe.errors import MissingDependencyError, SettingsError
from gscpe.service.service import Service

if TYPE_CHECKING:
    import uvicorn

_EXTRA = "pip install 'gscpe[serve]'"


def require_packages() -> None:
    """Raises MissingDependencyError where a package of the extra is missing."""
    try:
        import fastapi  # noqa: F401
        import python_multipart  # noqa: F401
        import uvicorn  # noqa: F401
        import websockets  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(f"gscpe serve needs more packages ({error}): {_EXTRA}") from (
            error
        )


def listen(host: str, port: int) -> socket.socket:
    """A socket at an address; port 0: any that is free.

    Raises:
        SettingsError: it cannot be used.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host.strip("[]"), port), family=family, backlog=512)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise SettingsError(f"cannot listen at {host} port {port}: {reason}") from error


def make_server(
    service: Service, certificate: str | Path | None = None, key: str | Path | None = None
) -> uvicorn.Server:
    """A uvicorn server of a service.

    Raises:
        SettingsError: certificate or key cannot be used.
    """
    import uvicorn

    from gscpe.service.app import make_app
    from gscpe.service.connection import Connection

    limits = service.limits
    config = uvicorn.Config(
        make_app(service),
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        lifespan="off",
        http=Connection,
        timeout_keep_alive=math.ceil(limits.idle_seconds),
        ws="websockets-sansio",
        ws_max_size=limits.body_bytes,
        ws_max_queue=4,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=math.ceil(2 * limits.seconds),
        ssl_certfile=certificate,
        ssl_keyfile=key,
    )
    try:
        config.load()
    except OSError as error:  # ssl.SSLError is one
        raise SettingsError(f"the certificate or its key cannot be used: {error}") from error
    return uvicorn.Server(config)
