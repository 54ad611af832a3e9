"""The map folder: everything that localization needs, in one place that can be moved.

Layout (docs/formats.md): ``map.json`` (format, version, size and CRC-32 of the other
files), ``gaussians.npz``, ``references.json``, ``retrieval.npz``.
"""

from __future__ import annotations

import io
import json
import shutil
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

import numpy as np
from numpy.typing import NDArray

from gscpe.errors import MapError, OutputError
from gscpe.geometry.camera import Camera
from gscpe.scene.gaussians import GaussianScene
from gscpe.scene.references import GlobalDescriptors, References

FORMAT = "gscpe map"
VERSION = 1
_GAUSSIANS, _REFERENCES, _RETRIEVAL = "gaussians.npz", "references.json", "retrieval.npz"
_CONTENTS = (_GAUSSIANS, _REFERENCES, _RETRIEVAL)
_SCENE_ARRAYS = ("means", "quaternions", "scales", "opacities", "sh")


@dataclass(frozen=True, eq=False)
class Map:
    """A Gaussian splat, its reference photos' poses, and their global descriptors.

    Attributes:
        metres_per_unit: of all coordinates; None where it is not known.
    """

    scene: GaussianScene
    references: References
    descriptors: GlobalDescriptors
    metres_per_unit: float | None = 1.0

    def __post_init__(self) -> None:
        if self.metres_per_unit is not None and not 0 < self.metres_per_unit < np.inf:
            raise MapError(f"metres per unit must be positive, not {self.metres_per_unit}")
        if len(self.references) != len(self.descriptors.descriptors):
            raise MapError("a map needs one global descriptor for each reference photo")


def save_map(map_: Map, folder: str | Path) -> None:
    """Writes a map folder; an existing gscpe map there is replaced once the new one is whole.

    Raises:
        OutputError: the folder cannot be written, or something else is there.
    """
    folder = Path(folder).absolute()
    check_map_output(folder)
    contents = {
        _GAUSSIANS: _npz(
            {name: getattr(map_.scene, name) for name in _SCENE_ARRAYS}
            | {
                "antialiased": np.array(map_.scene.antialiased),
                "metres_per_unit": np.array(map_.metres_per_unit or np.nan),
            }
        ),
        _REFERENCES: _references_to_json(map_.references),
        _RETRIEVAL: _npz(
            {
                "vocabulary": map_.descriptors.vocabulary,
                "descriptors": map_.descriptors.descriptors,
            }
        ),
    }
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
        (partial / "map.json").write_text(json.dumps(manifest, indent=2) + "\n")
        if folder.exists():
            shutil.rmtree(folder)
        partial.rename(folder)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise OutputError(f"map {folder} cannot be written: {error}") from error


def check_map_output(folder: str | Path) -> None:
    """Raises OutputError, before any long work, when a map cannot be written to this folder."""
    folder = Path(folder).absolute()
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
        MapError: it is missing, damaged, or of a newer version than this gscpe.
    """
    folder = Path(folder)
    manifest = _read_manifest(folder)
    files = manifest["files"]
    contents = {name: _read_checked(folder, name, files) for name in files}
    try:
        gaussians = _load_npz(contents[_GAUSSIANS])
        retrieval = _load_npz(contents[_RETRIEVAL])
        unit = float(gaussians["metres_per_unit"])
        return Map(
            scene=GaussianScene(
                means=gaussians["means"],
                quaternions=gaussians["quaternions"],
                scales=gaussians["scales"],
                opacities=gaussians["opacities"],
                sh=gaussians["sh"],
                antialiased=bool(gaussians["antialiased"]),
            ),
            references=_references_from_json(contents[_REFERENCES]),
            descriptors=GlobalDescriptors(retrieval["vocabulary"], retrieval["descriptors"]),
            metres_per_unit=None if np.isnan(unit) else unit,
        )
    except Exception as error:  # parsers raise KeyError, BadZipFile, EOFError, AttributeError, ...
        raise MapError(f"map {folder} is damaged ({error}); build it again") from error


def _temporary_beside(folder: Path) -> Path:
    """A new folder on the same disk, so that it can be renamed to ``folder``."""
    try:
        path = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        path.chmod(0o755)
        return path
    except OSError as error:
        raise OutputError(f"map {folder} cannot be written: {error.strerror}") from error


def _is_replaceable(folder: Path) -> bool:
    if not folder.is_dir():
        return False
    names = {entry.name for entry in folder.iterdir()}  # all of them would be deleted
    return not names or (_GAUSSIANS in names and names <= {"map.json", *_CONTENTS})


def _read_manifest(folder: Path) -> dict[str, Any]:
    path = folder / "map.json"
    if not path.is_file():
        raise MapError(f"{folder} is not a gscpe map: it has no map.json; see gscpe build-map")
    try:
        manifest = json.loads(path.read_text())
        is_map, version = manifest["format"] == FORMAT, int(manifest["version"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise MapError(f"{path} is damaged; build the map again") from error
    if not is_map:
        raise MapError(f"{path} does not describe a gscpe map")
    if version > VERSION:
        raise MapError(
            f"map {folder} has version {version}, this gscpe reads up to {VERSION}; update gscpe"
        )
    files = manifest.get("files")
    if not isinstance(files, dict) or set(files) != set(_CONTENTS):
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


def _npz(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _load_npz(data: bytes) -> dict[str, NDArray[Any]]:
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _references_to_json(references: References) -> bytes:
    entries = [
        {"name": name, "camera": camera.colmap_text(), "cam_from_world": pose.tolist()}
        for name, camera, pose in zip(
            references.names, references.cameras, references.cam_from_world, strict=True
        )
    ]
    return json.dumps(entries, indent=1).encode()


def _references_from_json(data: bytes) -> References:
    entries = json.loads(data)
    return References(
        names=tuple(str(entry["name"]) for entry in entries),
        cam_from_world=np.array([entry["cam_from_world"] for entry in entries], dtype=np.float64),
        cameras=tuple(Camera.parse(entry["camera"]) for entry in entries),
    )
