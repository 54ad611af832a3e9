# SPDX-License-Identifier: Apache-2.0
"""Fingerprints of map, settings and photos, by which resuming notices that they changed."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Mapping

from gscpe.errors import MapError, ModelError
from gscpe.localization import LocalizerSettings
from gscpe.matching.choose import ONNX


@dataclass(frozen=True)
class Fingerprint:
    """Of the map, and of the settings with the matcher: 12 hexadecimal digits each."""

    map: str
    settings: str


def map_fingerprint(folder: str | Path) -> str:
    """Changes with every file of the map: ``map.json`` holds their checksums.

    Raises:
        MapError: there is no ``map.json``, or it cannot be read.
    """
    path = Path(folder) / "map.json"
    if not path.is_file():
        raise MapError(f"{folder} is not a gscpe map: it has no map.json; see gscpe build-map")
    try:
        return _short_hash(path.read_bytes())
    except OSError as error:
        raise MapError(f"{path} cannot be read: {error.strerror}") from error


def maps_fingerprint(fingerprints: Mapping[str, str]) -> str:
    """Of several maps.

    Args:
        fingerprints: of each, by its name; their order does not count.
    """
    return _short_hash(repr(sorted(fingerprints.items())).encode())


def settings_fingerprint(settings: LocalizerSettings, matcher: str) -> str:
    """Changes with every setting, and with the matcher.

    Where the retrieval model lies does not count (the map knows its checksum), nor does the
    path of an ONNX matcher, only what is in it.

    Args:
        settings: of the localizer.
        matcher: a name of gscpe.matching.make_matcher, other than "auto".

    Raises:
        ModelError: the file of an ONNX matcher cannot be read.
    """
    text = f"{replace(settings, retrieval_model=None)!r} {matcher}"
    if not matcher.startswith(ONNX):
        return _short_hash(text.encode())
    path = Path(matcher.removeprefix(ONNX))
    beside = path.with_suffix(".json")
    try:
        contents = [path.read_bytes(), beside.read_bytes() if beside.is_file() else b""]
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {error.strerror}") from error
    text = f"{replace(settings, retrieval_model=None)!r} {ONNX}"
    return _short_hash(b"".join([text.encode(), *contents]))


def photo_fingerprint(path: str | Path) -> str | None:
    """12 hexadecimal digits that change with the photo's bytes; None where it cannot be read.

    All of it is read, which takes a hundredth of the time that localizing it does: copies may
    keep the time of another file, and a raw image that was edited its size.
    """
    path = Path(path)
    try:
        if not path.is_file():  # a pipe could be waited for
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()[:12]
    except OSError:
        return None


def _short_hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:12]
