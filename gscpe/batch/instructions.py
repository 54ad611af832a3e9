# SPDX-License-Identifier: Apache-2.0
"""What a worker is told: everything that it needs to localize, as small picklable data.

Part of it is a fingerprint of map and settings, by which resuming notices that they changed;
that of a photo is here too.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Mapping

from gscpe.batch.priors import with_priors
from gscpe.errors import MapError, ModelError, SettingsError
from gscpe.localization import LocalizerSettings, PosePrior
from gscpe.matching import matcher_name

_ONNX = "onnx:"

TIMEOUT = 600.0
"""Seconds, hundreds of times what a photo takes: a worker that is slower hangs."""


@dataclass(frozen=True)
class Fingerprint:
    """Of the map, and of the settings with the matcher: 12 hexadecimal digits each."""

    map: str
    settings: str


@dataclass(frozen=True)
class Instructions:
    """What a worker opens, and how it localizes. Made by :meth:`of`.

    Attributes:
        map_folder, image_folder: absolute, as the workers see them.
        settings: of the localizer.
        matcher: a name of gscpe.matching.make_matcher, other than "auto": which networks are
            installed must not differ between the workers.
        backend: of gscpe.render.Renderer.
        fingerprint: of map and settings; a worker refuses a map that has another one.
        threads: of a worker; None: one for each core.
        priors: where photos probably were taken, by name; others begin with retrieval.
        timeout: seconds that a worker may take to open the map, and for a photo; then another
            one takes its place, and the photo has failed. Where this process is the only
            worker, nothing can end it.
    """

    map_folder: Path
    image_folder: Path
    settings: LocalizerSettings
    matcher: str
    backend: str
    fingerprint: Fingerprint
    threads: int | None = None
    priors: Mapping[str, PosePrior] = field(default_factory=dict)
    timeout: float = TIMEOUT

    @classmethod
    def of(
        cls,
        map_folder: str | Path,
        image_folder: str | Path,
        settings: LocalizerSettings | None = None,
        matcher: str = "auto",
        backend: str = "auto",
        priors: Mapping[str, PosePrior] | None = None,
        timeout: float = TIMEOUT,
    ) -> Instructions:
        """Instructions with absolute paths, the matcher chosen, and the map as it is now.

        Raises:
            MapError: there is no map.
            ModelError: the file of an ONNX matcher cannot be read.
            SettingsError: the timeout is not positive.
        """
        if not timeout > 0:
            raise SettingsError(f"the timeout must be positive, not {timeout} s")
        settings = settings or LocalizerSettings()
        if settings.retrieval_model is not None:
            settings = replace(settings, retrieval_model=Path(settings.retrieval_model).absolute())
        matcher = _chosen(matcher)
        priors = priors or {}
        fingerprint = Fingerprint(
            map_fingerprint(map_folder),
            with_priors(settings_fingerprint(settings, matcher), priors),
        )
        folders = Path(map_folder).absolute(), Path(image_folder).absolute()
        return cls(
            *folders, settings, matcher, backend, fingerprint, priors=priors, timeout=timeout
        )


def _chosen(matcher: str) -> str:
    """The name that "auto" stands for here, and absolute paths."""
    if matcher.startswith(_ONNX):
        return f"{_ONNX}{Path(matcher.removeprefix(_ONNX)).absolute()}"
    return matcher_name(matcher)


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
    if not matcher.startswith(_ONNX):
        return _short_hash(text.encode())
    path = Path(matcher.removeprefix(_ONNX))
    beside = path.with_suffix(".json")
    try:
        contents = [path.read_bytes(), beside.read_bytes() if beside.is_file() else b""]
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {error.strerror}") from error
    text = f"{replace(settings, retrieval_model=None)!r} {_ONNX}"
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
