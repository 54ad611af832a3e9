# SPDX-License-Identifier: Apache-2.0
"""The map folder: everything that localization needs, in one place that can be moved.

Layout (docs/formats.md): ``map.json`` (format, version, size and CRC-32 of the other
files), and the files of gscpe.scene.map_contents. A certificate may lie beside them.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import zlib
from pathlib import Path
from typing import Any, Mapping

from gscpe.errors import MapError, MissingDependencyError, OutputError
from gscpe.given import parse_json, real_path
from gscpe.interrupts import interrupts_later
from gscpe.scene.map import Map
from gscpe.scene.map_contents import (
    COMPRESSED,
    GAUSSIANS,
    PLAIN,
    REFERENCE_FILES,
    from_contents,
    references_from_contents,
    to_contents,
)
from gscpe.scene.references import GlobalDescriptors, References
from gscpe.splats.through_gaussforge import require_gaussforge

FORMAT = "gscpe map"
VERSION = 4
_SEAL = "map.json"
CERTIFICATE, CERTIFICATE_PAGE = "certificate.json", "certificate.html"
"""How good the map is (gscpe.making); not of the map itself, which is opened without."""


def save_map(map_: Map, folder: str | Path, *, compress: bool = False) -> None:
    """Writes a map folder; an existing gscpe map there is replaced once the new one is whole.

    If the folder is a symbolic link, its target is written or replaced.

    Args:
        compress: store the Gaussians as ``.spz`` and the descriptors in half precision: less
            than a fifth of the size, and rounded (docs/formats.md says how much that costs).

    Raises:
        OutputError: the folder cannot be written, something else is there, or the scene does
            not fit into the compressed format.
        MissingDependencyError: compressing needs gaussforge, and it is not installed.
        MapError: the argument is not a Map.
    """
    if not isinstance(map_, Map):
        raise MapError(f"save_map saves a Map, not {_kind(map_)}; build_map makes one of a splat")
    folder = _behind_link(folder)
    check_map_output(folder, compress=compress)
    contents = to_contents(map_, compress)
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "gaussians": len(map_.scene),
        "references": len(map_.references),
        "files": {
            name: {"bytes": len(data), "crc32": zlib.crc32(data)} for name, data in contents.items()
        },
    }
    partial = _temporary_beside(folder)
    try:
        for name, data in contents.items():
            (partial / name).write_bytes(data)
        (partial / _SEAL).write_text(json.dumps(manifest, indent=2) + "\n")
        with interrupts_later():  # or there could be neither map
            _replace(folder, partial)
    except BaseException as error:  # Ctrl-C too
        shutil.rmtree(partial, ignore_errors=True)
        if isinstance(error, OSError):
            raise OutputError(f"map {folder} cannot be written: {error}") from error
        raise


def check_map_output(folder: str | Path, *, compress: bool = False) -> None:
    """Raises OutputError, before any long work, when a map cannot be written to this folder.

    Where it is to be compressed, and gaussforge is not installed: MissingDependencyError.
    """
    folder = _behind_link(folder)
    if compress:
        require_gaussforge(f"map {folder} cannot be compressed")
    if folder.exists() and not _is_replaceable(folder):
        raise OutputError(f"{folder} exists and is not a gscpe map; choose another output")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"map {folder} cannot be written: {error.strerror}") from error
    _temporary_beside(folder).rmdir()


def open_map(folder: str | Path) -> Map:
    """Opens a map folder.

    Raises:
        MapError: it is missing, damaged, or of a newer version than this gscpe; or what is given
            is not the path of a folder.
        MissingDependencyError: it is compressed, and gaussforge is not installed.
    """
    if not isinstance(folder, str | Path):
        raise MapError(f"a map is opened by the path of its folder; this is {_kind(folder)}")
    folder = Path(folder)
    if folder.is_file():
        raise MapError(
            f"{folder} is not a gscpe map: it is a file, and a map is a folder; gscpe build-map "
            "(in Python: read_splat, build_map, save_map) makes one of a splat"
        )
    manifest = _read_manifest(folder)
    files = manifest["files"]
    contents = {name: _read_checked(folder, name, files) for name in files}
    try:
        return from_contents(contents, folder)
    except MissingDependencyError:
        raise
    except Exception as error:  # parsers raise KeyError, BadZipFile, EOFError, AttributeError, ...
        raise MapError(f"map {folder} is damaged ({error}); build it again") from error


def open_references(folder: str | Path) -> tuple[References, GlobalDescriptors]:
    """What retrieval needs of a map: its references, in the map's frame, and their descriptors.
    The Gaussians are not read.

    Raises:
        MapError: as :func:`open_map`.
    """
    folder = Path(folder)
    files = _read_manifest(folder)["files"]
    contents = {name: _read_checked(folder, name, files) for name in REFERENCE_FILES}
    try:
        return references_from_contents(contents)
    except Exception as error:  # parsers raise KeyError, BadZipFile, EOFError, AttributeError, ...
        raise MapError(f"map {folder} is damaged ({error}); build it again") from error


def _kind(thing: object) -> str:
    return "None" if thing is None else f"a {type(thing).__name__}"


def _temporary_beside(folder: Path) -> Path:
    """A new folder on the same disk, so that it can be renamed to ``folder``."""
    try:
        path = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        path.chmod(0o755)
        return path
    except OSError as error:
        raise OutputError(f"map {folder} cannot be written: {error.strerror}") from error


def _behind_link(folder: str | Path) -> Path:
    """The absolute path, and of a symbolic link that of what it leads to, which may be missing."""
    folder = Path(folder).absolute()
    if not folder.is_symlink():
        return folder
    try:
        target = real_path(folder)
        if not target.is_symlink():
            return target
    except (OSError, RuntimeError):  # differs between versions of Python
        pass
    raise OutputError(f"map {folder} cannot be written: it is a symbolic link to itself")


def _replace(folder: Path, partial: Path) -> None:
    """Puts the new map in the place of an old one, which comes back where that fails."""
    if not folder.exists():
        partial.rename(folder)
        return
    old = partial.with_name(f"{partial.name}.old")
    folder.rename(old)
    try:
        partial.rename(folder)
    except OSError:
        old.rename(folder)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _is_replaceable(folder: Path) -> bool:
    if not folder.is_dir():
        return False
    names = {entry.name for entry in folder.iterdir()}  # all of them would be deleted
    known = {_SEAL, CERTIFICATE, CERTIFICATE_PAGE, *PLAIN, *COMPRESSED}
    return not names or (bool(names & GAUSSIANS) and names <= known)


def _read_manifest(folder: Path) -> dict[str, Any]:
    path = folder / _SEAL
    if not path.is_file():
        raise MapError(f"{folder} is not a gscpe map: it has no map.json; see gscpe build-map")
    try:
        manifest = parse_json(path.read_text())
        is_map, version = manifest["format"] == FORMAT, manifest["version"]
        if not isinstance(version, int):
            raise TypeError("no whole number")
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise MapError(f"{path} is damaged; build the map again") from error
    if not is_map:
        raise MapError(f"{path} does not describe a gscpe map")
    if version > VERSION:
        raise MapError(
            f"map {folder} has version {version}, this gscpe reads {VERSION}; update gscpe"
        )
    if version < VERSION:
        raise MapError(
            f"map {folder} has version {version}, this gscpe reads {VERSION}; build the map again"
        )
    files = manifest.get("files")
    if not isinstance(files, dict) or set(files) not in (PLAIN, COMPRESSED):
        raise MapError(f"{path} is damaged; build the map again")
    return dict(manifest)


def _read_checked(folder: Path, name: str, files: Mapping[str, Mapping[str, int]]) -> bytes:
    try:
        data = (folder / name).read_bytes()
    except OSError as error:
        raise MapError(f"{folder / name} cannot be read: {error.strerror}") from error
    expected = files[name]
    if not isinstance(expected, dict) or zlib.crc32(data) != expected.get("crc32"):
        raise MapError(f"{folder / name} is damaged (its checksum is wrong); build the map again")
    return data
