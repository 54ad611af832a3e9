"""Splat files other than the standard ``.ply``, through gaussforge, by way of ``.ply``."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

from gscpe.errors import MissingDependencyError, SplatError

FORMATS = {".splat": "splat", ".ksplat": "ksplat", ".spz": "spz", ".sog": "sog"}
"""File endings, and what gaussforge calls the formats."""

COMPRESSED_PLY = "compressed.ply"

_PROGRAM = Path(__file__).with_name("convert_splat.py")
_SECONDS = 600


def to_ply(path: Path, kind: str) -> tuple[bytes, bool]:
    """A splat file as the bytes of a standard ``.ply``, and whether it is tagged as
    antialiased. Coordinates stay as they are stored.

    Raises:
        SplatError: the file is not a splat of this kind.
        MissingDependencyError: gaussforge is not installed.
    """
    if importlib.util.find_spec("gaussforge") is None:
        raise MissingDependencyError(
            f"{path}: splats that are not .ply need gaussforge: pip install 'gscpe[formats]'"
        )
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "converted.ply"
        command = [sys.executable, str(_PROGRAM), kind, str(path), str(target)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=_SECONDS, check=True
            )
            ply = target.read_bytes()
        except (subprocess.SubprocessError, OSError) as error:
            raise SplatError(
                f"{path} is not a readable {kind} file (damaged or truncated?); "
                "copy or export it again"
            ) from error
    return ply, done.stdout.splitlines()[-1] == "antialiased"
