# SPDX-License-Identifier: Apache-2.0
"""Reads splat files into a GaussianScene: the standard ``.ply``, and what converts to it."""

from __future__ import annotations

import io
import logging
import math
from pathlib import Path
from typing import Any, Sequence

import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array, Float64Array
from gscpe.errors import SplatError
from gscpe.splats.gaussians import GaussianScene, far_origin, joined
from gscpe.splats.ply_bytes import ANTIALIASED_COMMENT
from gscpe.splats.sog_folder import bundled, finest_chunks
from gscpe.splats.splat_kind import (
    PLY,
    SOG_FOLDER,
    STREAMED_SOG,
    for_gaussforge,
    ply_header,
    splat_kind,
)
from gscpe.splats.splat_rows import gaussians_from_rows
from gscpe.splats.through_gaussforge import to_ply

_log = logging.getLogger(__name__)

_MAX_DEGREE = 3
# How exporters say, in a header comment, that opacity compensation must be applied.
_ANTIALIASED_COMMENTS = {f"comment {ANTIALIASED_COMMENT.lower()}", "comment antialiased 1"}
_INDEX_FILES = ("lod-meta.json", "meta.json")  # of splats that are folders


def read_splat(path: str | Path) -> GaussianScene:
    """The Gaussians of a splat file; the format is detected from the first bytes, not the ending.

    A ``.ply`` holds log scales, logit opacities and ``f_rest`` colour by colour, binary or text;
    harmonics beyond degree 3 are left out. PlayCanvas's compressed ``.ply``, ``.splat``,
    ``.ksplat``, ``.spz`` and ``.sog`` are read through gaussforge, their coordinates as they are
    stored, and so are folders with SOG's ``meta.json`` or ``lod-meta.json`` (give either). Rows
    that cannot be used are left out, with a warning; see
    :func:`gscpe.splats.splat_rows.gaussians_from_rows`.

    Raises:
        SplatError: the file is missing, truncated, not a splat, empty, or most of its rows hold
            NaN or infinite values. The message names the file.
        MissingDependencyError: the format needs gaussforge, and it is not installed.
    """
    path = _index_file(Path(path))
    return splat_from_bytes(_read_bytes(path), path)


def splat_from_bytes(data: bytes, path: Path) -> GaussianScene:
    """As :func:`read_splat`, of a file that has been read; ``path`` is for messages, and for
    files beside it."""
    kind = splat_kind(path, data)
    if kind == STREAMED_SOG:
        chunks = finest_chunks(path, data)
        scenes = [(read_splat(chunk.meta), chunk.rows) for chunk in chunks]
        return joined([_rows_of(scene, rows, path) for scene, rows in scenes])
    if kind == PLY:
        antialiased = _is_antialiased(data)
    elif kind == SOG_FOLDER:
        data, antialiased = to_ply(bundled(path, data), "sog", path)
    else:
        data, antialiased = to_ply(for_gaussforge(data), kind, path)
    return _scene(_parse_ply(data, path), antialiased, path)


def _scene(vertices: NDArray[np.void], antialiased: bool, path: Path) -> GaussianScene:
    names = vertices.dtype.names or ()

    def columns(*wanted: str, dtype: type[Any] = np.float32) -> NDArray[Any]:
        missing = [name for name in wanted if name not in names]
        if missing:
            raise SplatError(
                f"{path} is a PLY but not a Gaussian splat: it has no {', '.join(missing)}; "
                "export the trained splat, not a point cloud or a mesh"
            )
        with np.errstate(over="ignore"):  # rows with infinite values are left out
            return np.stack([np.asarray(vertices[name], dtype=dtype) for name in wanted], axis=1)

    means, origin = _near_an_origin(columns("x", "y", "z", dtype=np.float64))
    flat = "scale_2" not in names and "scale_1" in names  # surfels of 2D Gaussian Splatting
    log_scales = columns("scale_0", "scale_1", *(() if flat else ("scale_2",)))
    quaternions = columns("rot_0", "rot_1", "rot_2", "rot_3")
    logits = columns("opacity")[:, 0]
    base = columns("f_dc_0", "f_dc_1", "f_dc_2")
    rest_count = sum(name.startswith("f_rest_") for name in names)
    stored = rest_count // 3 + 1  # coefficients a colour
    degree = math.isqrt(stored) - 1
    if rest_count % 3 or (degree + 1) ** 2 != stored:
        raise SplatError(f"{path} has {rest_count} f_rest properties; expected 0, 9, 24 or 45")
    if degree > _MAX_DEGREE:
        _log.warning("%s: harmonics of degree %d are cut to degree 3", path, degree)
    kept = (min(degree, _MAX_DEGREE) + 1) ** 2
    sh = np.empty((len(means), kept, 3), dtype=np.float32)
    sh[:, 0] = base
    for colour in range(3 if kept > 1 else 0):
        first = colour * (stored - 1)
        sh[:, 1:, colour] = columns(*(f"f_rest_{first + i}" for i in range(kept - 1)))
    return gaussians_from_rows(
        str(path), means, log_scales, quaternions, logits, sh, antialiased, origin
    )


def _index_file(path: Path) -> Path:
    """The file to begin with, where a splat is a folder."""
    if path.is_dir():
        for name in _INDEX_FILES:
            if (path / name).is_file():
                return path / name
    return path


def _rows_of(
    scene: GaussianScene, rows: Sequence[tuple[int, int]] | None, path: Path
) -> GaussianScene:
    """These ranges of a scene's rows; None: all of them."""
    if rows is None or rows == ((0, len(scene)),):
        return scene
    if max(end for _, end in rows) > len(scene) or min(begin for begin, _ in rows) < 0:
        raise SplatError(f"{path} names Gaussians that a chunk does not have; export it again")
    return scene.taken(np.concatenate([np.arange(*each) for each in rows]))


def _near_an_origin(means: Float64Array) -> tuple[Float32Array, Float64Array]:
    """Means as float32, (N, 3), relative to an origin, (3,): zero, unless the scene is so far from
    it (UTM) that float32 would lose what matters."""
    finite = means[np.isfinite(means).all(axis=1)]
    origin = np.zeros(3)
    if len(finite):
        middle = np.median(finite, axis=0)
        spread = float(np.median(np.linalg.norm(finite - middle, axis=1)))
        origin = far_origin(middle, spread)
    with np.errstate(over="ignore"):  # rows with infinite values are left out
        return (means - origin).astype(np.float32), origin


def _read_bytes(path: Path) -> bytes:
    if not path.is_file():
        raise SplatError(f"{path} does not exist or is not a file; give the trained splat (.ply)")
    try:
        return path.read_bytes()
    except OSError as error:
        raise SplatError(f"{path} cannot be read: {error.strerror}") from error
    except MemoryError as error:
        raise SplatError(f"{path} does not fit into memory") from error


def _parse_ply(data: bytes, path: Path) -> NDArray[np.void]:
    from trimesh.exchange.ply import load_ply  # half a second, and only needed to build maps

    try:
        loaded = load_ply(io.BytesIO(data), skip_materials=True)
        element = loaded["metadata"]["_ply_raw"]["vertex"]
        vertices = element["data"] if element["length"] else np.zeros(0, dtype=[("x", np.float32)])
        if isinstance(vertices, dict):  # the text format is parsed into columns
            vertices = _rows(vertices, element["length"])
    except MemoryError as error:
        raise SplatError(f"{path} claims more Gaussians than fit into memory") from error
    except Exception as error:  # the parser raises whatever a damaged file makes it stumble on
        raise SplatError(
            f"{path} is not a readable PLY file (damaged or truncated?); copy or export it again"
        ) from error
    if not isinstance(vertices, np.ndarray) or vertices.dtype.names is None:
        raise SplatError(f"{path} is a PLY but not a Gaussian splat; export the trained splat")
    if len(vertices) == 0:
        raise SplatError(f"{path} is empty: it holds no Gaussians; train or export it again")
    return vertices


def _rows(columns: dict[str, NDArray[Any]], count: int) -> NDArray[np.void]:
    """A structured array of columns of this length; ValueError where they have another."""
    rows = np.empty(count, dtype=[(name, np.float64) for name in columns])
    for name, column in columns.items():
        rows[name] = column.reshape(count)
    return rows


def _is_antialiased(data: bytes) -> bool:
    lines = ply_header(data).decode("ascii", "replace").lower().splitlines()
    return any(line.strip() in _ANTIALIASED_COMMENTS for line in lines)
