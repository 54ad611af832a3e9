# SPDX-License-Identifier: Apache-2.0
"""Splat files other than the standard ``.ply``, through gaussforge, by way of ``.ply``."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

from gscpe.errors import MissingDependencyError, OutputError, SplatError

_PROGRAM = Path(__file__).with_name("gaussforge_program.py")
_SECONDS = 600


def require_gaussforge(what: str) -> None:
    """Raises MissingDependencyError, with the remedy, where gaussforge is not installed."""
    if importlib.util.find_spec("gaussforge") is None:
        raise MissingDependencyError(
            f"{what}: splats that are not .ply need gaussforge: pip install 'gscpe[formats]'"
        )


def to_ply(data: bytes, kind: str, path: Path) -> tuple[bytes, bool]:
    """A splat file's bytes as those of a standard ``.ply``, and whether it is tagged as
    antialiased. Coordinates stay as they are stored.

    Args:
        data: of the file.
        kind: what gaussforge calls the format.
        path: of the file, for messages.

    Raises:
        SplatError: the file is not a splat of this kind.
        MissingDependencyError: gaussforge is not installed.
    """
    require_gaussforge(str(path))
    try:
        return _convert(kind, "ply", data)
    except (subprocess.SubprocessError, OSError) as error:
        raise SplatError(
            f"{path} is not a readable {kind} file (damaged or truncated?); copy or export it again"
        ) from error


def from_ply(ply: bytes, kind: str) -> bytes:
    """A binary little-endian ``.ply`` as another format; the antialiased tag is lost.

    Raises:
        OutputError: gaussforge cannot convert it, or there is no room for temporary files.
        MissingDependencyError: gaussforge is not installed.
    """
    require_gaussforge(f"cannot write .{kind}")
    try:
        return _convert("ply", kind, ply)[0]
    except (subprocess.SubprocessError, OSError) as error:
        raise OutputError(f"gaussforge could not make {kind} of the splat: {error}") from error


def _convert(source_kind: str, target_kind: str, data: bytes) -> tuple[bytes, bool]:
    """The converted file, and whether the source is tagged as antialiased."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "source", Path(folder) / "converted"
        source.write_bytes(data)
        # -P: modules beside the program are not to be taken for others of the same name.
        command = [sys.executable, "-P", str(_PROGRAM), source_kind, target_kind, str(source)]
        done = subprocess.run(
            [*command, str(target)], capture_output=True, text=True, timeout=_SECONDS, check=True
        )
        return target.read_bytes(), done.stdout.splitlines()[-1] == "antialiased"
