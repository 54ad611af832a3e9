# SPDX-License-Identifier: Apache-2.0
"""Which format a splat file is in: its first bytes decide, its ending only where they cannot."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from pathlib import Path

from gscpe.errors import SplatError

PLY, COMPRESSED_PLY, SOG_FOLDER, STREAMED_SOG = "ply", "compressed.ply", "sog folder", "sog levels"
_ENDINGS = {".ply": PLY, ".splat": "splat", ".ksplat": "ksplat", ".spz": "spz", ".sog": "sog"}
READABLE = ", ".join(_ENDINGS)
"""The endings of files that are read, for messages."""

_TRANSFORM = "convert it to .ply with splat-transform (npx @playcanvas/splat-transform IN OUT.ply)"
_EXPORT = "export a .ply from the program that trained it (nerfstudio: ns-export gaussian-splat)"
_OTHERS = {
    ".lcc": f"an LCC scene of XGRIDS: {_TRANSFORM}",
    ".lcc2": f"an LCC scene of XGRIDS: {_TRANSFORM}",
    ".pt": f"a trainer's checkpoint: {_EXPORT}",
    ".pth": f"a trainer's checkpoint: {_EXPORT}",
    ".ckpt": f"a trainer's checkpoint: {_EXPORT}",
    ".npz": f"NumPy's arrays: {_EXPORT}",
    ".psht": "a Postshot project: export a .ply from Postshot",
    ".glb": "a glTF scene: export a .ply from the program that wrote it",
    ".gltf": "a glTF scene: export a .ply from the program that wrote it",
    ".usd": "a USD scene: export a .ply from the program that wrote it",
    ".usdz": "a USD scene: export a .ply from the program that wrote it",
    ".las": "a point cloud: give the trained splat",
    ".laz": "a point cloud: give the trained splat",
    ".obj": "a mesh: give the trained splat",
}
_SPZ_MAGIC, _GZIP, _ZIP = b"NGSP", b"\x1f\x8b", b"PK\x03\x04"
_SPZ_OF_STREAMS = 4  # from this version on, .spz is no gzip stream


def splat_kind(path: Path, data: bytes) -> str:
    """PLY, COMPRESSED_PLY, SOG_FOLDER (a ``meta.json``), STREAMED_SOG (a ``lod-meta.json``), or
    what gaussforge calls the format.

    Raises:
        SplatError: it is another kind of file; the message says what converts it.
    """
    suffix = path.suffix.lower()
    if data[:3] == b"ply" and data[3:4].isspace():
        return COMPRESSED_PLY if b"element chunk" in ply_header(data) else PLY
    if data[:4] == _SPZ_MAGIC or _within_gzip(data)[:4] == _SPZ_MAGIC:
        return "spz"
    if _within_gzip(data)[:3] == b"ply":
        raise SplatError(f"{path} is a .ply within gzip; unpack it with gunzip first")
    if data[:4] == _ZIP:
        return _kind_of_zip(path, data)
    if data.lstrip()[:1] == b"{":
        return STREAMED_SOG if path.name.lower().startswith("lod") else SOG_FOLDER
    if suffix in _ENDINGS:
        return _ENDINGS[suffix]
    raise _unreadable(path)


def for_gaussforge(data: bytes) -> bytes:
    """A file's bytes as gaussforge takes them: an ``.spz`` that was written without its gzip gets
    one."""
    if data[:4] != _SPZ_MAGIC or len(data) < 8:
        return data
    (version,) = struct.unpack_from("<I", data, 4)
    if version >= _SPZ_OF_STREAMS:
        return data
    packer = zlib.compressobj(1, wbits=31)
    return packer.compress(data) + packer.flush()


def may_have_other_axes(path: str | Path) -> bool:
    """Whether a splat is of a format whose files are often turned: y and z negated against the
    ``.ply`` of the same splat (``.spz``, ``.sog``), and do not say so.

    Raises:
        SplatError: as :func:`splat_kind`, or the file cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        return True
    try:
        with path.open("rb") as file:
            start = file.read(1 << 16)
    except OSError as error:
        raise SplatError(f"{path} cannot be read: {error.strerror}") from error
    if start[:4] == _ZIP:
        return True
    return splat_kind(path, start) in ("spz", "sog", SOG_FOLDER, STREAMED_SOG)


def ply_header(data: bytes) -> bytes:
    """The header of a PLY file."""
    return data[:8192].split(b"end_header")[0]


def _within_gzip(data: bytes) -> bytes:
    """The first bytes of a gzip stream's content; empty where it is none."""
    if data[:2] != _GZIP:
        return b""
    try:
        return zlib.decompressobj(wbits=31).decompress(data[:4096], 16)
    except zlib.error:
        return b""


def _kind_of_zip(path: Path, data: bytes) -> str:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
    except zipfile.BadZipFile:
        names = []
    if path.suffix.lower() == ".sog" or "meta.json" in names:
        return "sog"
    if any(name.endswith("data.pkl") for name in names):
        raise SplatError(f"{path} is {_OTHERS['.pt']}")
    if path.suffix.lower() in _OTHERS:
        raise _unreadable(path)
    raise SplatError(f"{path} is a zip archive; unpack it, and give the splat that is in it")


def _unreadable(path: Path) -> SplatError:
    what = _OTHERS.get(path.suffix.lower())
    if what is not None:
        return SplatError(f"{path} is {what}")
    return SplatError(f"{path} is not a splat of a supported kind ({READABLE}); {_TRANSFORM}")
