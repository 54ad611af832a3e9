# SPDX-License-Identifier: Apache-2.0
"""Writes a GaussianScene to a splat file."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Callable

from gscpe.errors import OutputError
from gscpe.output_file import write_file
from gscpe.splats.compression import outliers
from gscpe.splats.gaussians import GaussianScene
from gscpe.splats.ply_bytes import ply_bytes
from gscpe.splats.spz import encode_spz

_log = logging.getLogger(__name__)


def write_splat(scene: GaussianScene, path: str | Path) -> None:
    """Writes a splat; the ending names the format. An older file is replaced at the end.

    ``.ply``: the standard 3D Gaussian Splatting layout, binary, exact to float32 rounding;
    the coordinates in double precision where the scene has an origin far away.
    ``.spz``: about a tenth of the size, through gaussforge; for the cost of rounding see
    :func:`gscpe.splats.spz.encode_spz`. A few Gaussians so far away or so huge that the others
    would be rounded coarsely with them are left out, with a warning. Coordinates and axes stay as
    they are, and the antialiased tag is written in both.

    Raises:
        OutputError: the ending is another one, the file cannot be written, or the scene
            exceeds the range of the format.
        MissingDependencyError: ``.spz`` needs gaussforge, and it is not installed.
    """
    path = Path(path)
    encode = _ENCODERS.get(path.suffix.lower())
    if encode is None:
        raise OutputError(f"{path}: cannot write splats of this kind; use {' or '.join(_ENCODERS)}")
    try:
        data = encode(scene)
    except OutputError as error:
        raise OutputError(f"{path}: {error}; write a .ply, or scale the scene") from None
    write_file(path, data)


def _encode_spz(scene: GaussianScene) -> bytes:
    apart = outliers(scene, colours=False)
    if not apart.kinds:
        return encode_spz(scene)
    _log.warning(
        "%d of %d Gaussians are left out of the .spz, because with them the "
        "others would be rounded too coarsely: %s",
        apart.rows.sum(),
        len(scene),
        apart.kinds,
    )  # fmt: skip
    return encode_spz(scene.taken(~apart.rows))


_ENCODERS: dict[str, Callable[[GaussianScene], bytes]] = {".ply": ply_bytes, ".spz": _encode_spz}
