# SPDX-License-Identifier: Apache-2.0
"""The user's model folder: ``MODEL/NETWORK.onnx`` with a manifest, licence and attribution."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Mapping

from gscpe.errors import ModelError, OutputError
from gscpe.given import parse_json
from gscpe.models.catalogue import CATALOGUE, ModelSource, find_source
from gscpe.output_file import replace_file

VERSION = 1
"""Of the graphs that this gscpe makes; models of another version are made anew."""

FOLDER_VARIABLE = "GSCPE_MODELS"
_MANIFEST = "model.json"
_NO_HOME = (
    "this user has no home directory, so there is no folder for trained networks; set the "
    f"environment variable {FOLDER_VARIABLE} to a folder"
)


@dataclass(frozen=True)
class InstalledFile:
    """One network in the model folder.

    Attributes:
        state: "ok", "missing", "damaged" (its checksum is wrong) or "outdated" (made by
            another version of gscpe).
        size: in bytes, 0 where it is missing.
    """

    model: str
    path: Path
    size: int
    state: str


def models_folder() -> Path:
    """Where models are: ``$GSCPE_MODELS`` if set, else in the platform's cache folder.

    Raises:
        ModelError: this user has no home, and the variable names no folder.
    """
    chosen = os.environ.get(FOLDER_VARIABLE)
    try:
        if chosen:
            return Path(chosen).expanduser().absolute()
        import platformdirs

        cache = Path(platformdirs.user_cache_dir("gscpe", appauthor=False))
    except RuntimeError as error:
        raise ModelError(_NO_HOME) from error
    if not cache.is_absolute():  # an older platformdirs leaves the ~ where it was
        raise ModelError(_NO_HOME)
    return cache / "models"


def model_path(model: str, network: str) -> Path:
    """Path of one network, such as ("xfeat", "xfeat.onnx").

    Raises:
        ModelError: it is not installed.
    """
    path = models_folder() / model / network
    if not os.path.isfile(path):  # also false where the folder above may not be read
        raise ModelError(f"{path} is missing; get it with: {install_command(model)}")
    return path


def install_command(model: str) -> str:
    return f"gscpe models install {model}"


def installed_files(model: str | None = None) -> tuple[InstalledFile, ...]:
    """The networks of one model (of all, if None), installed or not; checksums are verified.

    Where there is no model folder, all are missing.

    Raises:
        ModelError: there is no model of this name.
    """
    sources = list(CATALOGUE.values()) if model is None else [find_source(model)]
    return tuple(_inspect(each.name, network) for each in sources for network in each.networks)


def is_installed(source: ModelSource) -> bool:
    """Whether all networks of a model are there, whole, and of this version."""
    return all(file.state == "ok" for file in installed_files(source.name))


def write_model(source: ModelSource, networks: Mapping[str, bytes], licence: bytes) -> Path:
    """Writes the networks of a model, with licence and attribution; returns the folder.

    Each file appears whole or not at all, the manifest last.

    Raises:
        OutputError: the folder cannot be written.
    """
    folder = models_folder() / source.name
    manifest = {
        "format": "gscpe model",
        "version": VERSION,
        "source": source.requirement,
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in networks.items()},
    }
    contents = {
        "LICENSE": licence,
        "ATTRIBUTION.txt": source.attribution.encode(),
        **networks,
        _MANIFEST: (json.dumps(manifest, indent=2) + "\n").encode(),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in contents.items():
            replace_file(folder / name, data)
    except OSError as error:
        raise OutputError(
            f"models cannot be written to {folder}: {error.strerror}; "
            f"name another folder in the environment variable {FOLDER_VARIABLE}"
        ) from error
    return folder


def _inspect(model: str, network: str) -> InstalledFile:
    try:
        path = models_folder() / model / network
    except ModelError:  # a folder that there is not is empty
        return InstalledFile(model, Path(model) / network, 0, "missing")
    try:
        data = path.read_bytes()
    except OSError:
        return InstalledFile(model, path, 0, "missing")
    return InstalledFile(model, path, len(data), _state(path, data))


def _state(path: Path, data: bytes) -> str:
    try:
        manifest = parse_json((path.parent / _MANIFEST).read_bytes())
        version, expected = manifest["version"], manifest["sha256"][path.name]
    except (OSError, ValueError, KeyError, TypeError):
        return "damaged"
    if version != VERSION:
        return "outdated"
    return "ok" if hashlib.sha256(data).hexdigest() == expected else "damaged"
