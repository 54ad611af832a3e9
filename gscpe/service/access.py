# SPDX-License-Identifier: Apache-2.0
"""Who may ask: only this machine, or whoever has the token; and no web page of somebody else."""

from __future__ import annotations

import hmac
import ipaddress
from pathlib import Path
from urllib.parse import urlsplit

from gscpe.errors import SettingsError

_LEAST = 16
"""Letters of a token."""

_LOCAL_NAMES = {"localhost", "127.0.0.1", "::1"}


def read_token(path: str | Path) -> str:
    """The token in a file: its text without blanks at the ends.

    Raises:
        SettingsError: it cannot be read, or is too short or of other letters than ASCII.
    """
    try:
        token = Path(path).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise SettingsError(f"--token-file {path} cannot be read: {reason}") from error
    if len(token) < _LEAST or not (token.isascii() and token.isprintable()) or " " in token:
        raise SettingsError(
            f"--token-file {path} must hold one word of at least {_LEAST} ASCII letters, for "
            "example of: openssl rand -hex 32"
        )
    return token


def is_local(host: str) -> bool:
    """Whether only this machine can reach an address that a server listens at."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def check_exposure(host: str, token: str | None, insecure: bool) -> None:
    """Raises SettingsError where others could reach a service without a token."""
    if token is None and not insecure and not is_local(host):
        raise SettingsError(
            f"--host {host} can be reached by others: give a --token-file, or --insecure if "
            "everybody may use the service"
        )


def bears(header: str | None, token: str) -> bool:
    """Whether the header ``Authorization`` holds the token."""
    scheme, _, given = (header or "").partition(" ")
    return scheme.lower() == "bearer" and is_token(given.strip(), token)


def is_token(given: str, token: str) -> bool:
    """Compared in a time that does not tell how much of it was right."""
    return hmac.compare_digest(given.encode(errors="replace"), token.encode())


def host_name(header: str) -> str:
    """The name in the header ``Host``, without its port; empty where it is none."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def is_own_host(header: str, bound: str) -> bool:
    """Whether a request to a service of this machine alone came by one of its names. By another
    name, it comes from a web page whose author let that name lead here (DNS rebinding)."""
    name = host_name(header)
    return name in _LOCAL_NAMES or name == bound.strip("[]").lower()


def is_own_page(origin: str | None, host: str) -> bool:
    """Whether the page that sent a request, if one did, is the service's own: another's could use
    what its reader may use.

    Args:
        origin: of the header ``Origin``; browsers send it, programs do not.
        host: of the header ``Host``.
    """
    if origin is None:
        return True
    return urlsplit(origin).netloc.lower() == host.lower()
