"""Reads splat files into a GaussianScene: the standard ``.ply``, and what converts to it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array, Float64Array
from gscpe.errors import SplatError
from gscpe.scene.gaussians import GaussianScene, far_origin, normalized_quaternions
from gscpe.scene.ply_bytes import ANTIALIASED_COMMENT
from gscpe.scene.splat_formats import COMPRESSED_PLY, FORMATS, to_ply

_REST_COUNT_TO_COEFFICIENTS = {0: 1, 9: 4, 24: 9, 45: 16}
# How exporters say, in a header comment, that opacity compensation must be applied.
_ANTIALIASED_COMMENTS = {f"comment {ANTIALIASED_COMMENT.lower()}", "comment antialiased 1"}


def read_splat(path: str | Path) -> GaussianScene:
    """The Gaussians of a splat file.

    A ``.ply`` holds log scales, logit opacities and ``f_rest`` colour by colour, degrees 0 to
    3, binary or text. PlayCanvas's compressed ``.ply``, ``.splat``, ``.ksplat``, ``.spz`` and
    ``.sog`` are read through gaussforge, their coordinates as they are stored.

    Raises:
        SplatError: the file is missing, truncated, not a splat, empty, or holds NaN or
            infinite values. The message names the file.
        MissingDependencyError: the format needs gaussforge, and it is not installed.
    """
    path = Path(path)
    data = _read_bytes(path)
    kind = _foreign_kind(path, data)
    if kind is None:
        antialiased = _is_antialiased(data)
    else:
        data, antialiased = to_ply(path, kind)
    vertices = _parse_ply(data, path)
    names = vertices.dtype.names or ()

    def columns(*wanted: str, dtype: type[Any] = np.float32) -> NDArray[Any]:
        missing = [name for name in wanted if name not in names]
        if missing:
            raise SplatError(
                f"{path} is a PLY but not a Gaussian splat: it has no {', '.join(missing)}; "
                "export the trained splat, not a point cloud or a mesh"
            )
        return np.stack([np.asarray(vertices[name], dtype=dtype) for name in wanted], axis=1)

    means, origin = _near_an_origin(columns("x", "y", "z", dtype=np.float64))
    log_scales = columns("scale_0", "scale_1", "scale_2")
    quaternions = columns("rot_0", "rot_1", "rot_2", "rot_3")
    opacity_logits = columns("opacity")[:, 0]
    base = columns("f_dc_0", "f_dc_1", "f_dc_2")
    rest_count = sum(name.startswith("f_rest_") for name in names)
    if rest_count not in _REST_COUNT_TO_COEFFICIENTS:
        raise SplatError(f"{path} has {rest_count} f_rest properties; expected 0, 9, 24 or 45")
    coefficients = _REST_COUNT_TO_COEFFICIENTS[rest_count]
    sh = np.empty((len(means), coefficients, 3), dtype=np.float32)
    sh[:, 0] = base
    if rest_count:
        rest = columns(*(f"f_rest_{i}" for i in range(rest_count)))
        sh[:, 1:] = rest.reshape(len(means), 3, coefficients - 1).transpose(0, 2, 1)

    try:
        with np.errstate(over="ignore"):  # an infinite scale is reported by GaussianScene
            return GaussianScene(
                means=means,
                quaternions=normalized_quaternions(quaternions),
                scales=np.exp(log_scales),
                opacities=np.asarray(1.0 / (1.0 + np.exp(-opacity_logits)), dtype=np.float32),
                sh=sh,
                antialiased=antialiased,
                origin=origin,
            )
    except SplatError as error:
        raise SplatError(f"{path}: {error}") from None


def _near_an_origin(means: Float64Array) -> tuple[Float32Array, Float64Array]:
    """Means as float32, (N, 3), relative to an origin, (3,): zero, unless the scene is so far from
    it (UTM) that float32 would lose what matters."""
    finite = means[np.isfinite(means).all(axis=1)]
    origin = np.zeros(3)
    if len(finite):
        middle = np.median(finite, axis=0)
        spread = float(np.median(np.linalg.norm(finite - middle, axis=1)))
        origin = far_origin(middle, spread)
    with np.errstate(over="ignore"):  # GaussianScene reports what is infinite
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


def _foreign_kind(path: Path, data: bytes) -> str | None:
    """gaussforge's name of the format, or None for a standard .ply."""
    if path.suffix.lower() in FORMATS:
        return FORMATS[path.suffix.lower()]
    return COMPRESSED_PLY if b"element chunk" in _header(data) else None


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


def _header(data: bytes) -> bytes:
    return data[:8192].split(b"end_header")[0]


def _is_antialiased(data: bytes) -> bool:
    lines = _header(data).decode("ascii", "replace").lower().splitlines()
    return any(line.strip() in _ANTIALIASED_COMMENTS for line in lines)
