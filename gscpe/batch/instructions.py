"""What a worker is told: everything that it needs to localize, as small picklable data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from gscpe.batch.fingerprint import Fingerprint, map_fingerprint, settings_fingerprint
from gscpe.localization import LocalizerSettings
from gscpe.matching import matcher_name

_ONNX = "onnx:"


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
    """

    map_folder: Path
    image_folder: Path
    settings: LocalizerSettings
    matcher: str
    backend: str
    fingerprint: Fingerprint
    threads: int | None = None

    @classmethod
    def of(
        cls,
        map_folder: str | Path,
        image_folder: str | Path,
        settings: LocalizerSettings | None = None,
        matcher: str = "auto",
        backend: str = "auto",
    ) -> Instructions:
        """Instructions with absolute paths, the matcher chosen, and the map as it is now.

        Raises:
            MapError: there is no map.
            ModelError: the file of an ONNX matcher cannot be read.
        """
        settings = settings or LocalizerSettings()
        if settings.retrieval_model is not None:
            settings = replace(settings, retrieval_model=Path(settings.retrieval_model).absolute())
        matcher = _chosen(matcher)
        fingerprint = Fingerprint(
            map_fingerprint(map_folder), settings_fingerprint(settings, matcher)
        )
        folders = Path(map_folder).absolute(), Path(image_folder).absolute()
        return cls(*folders, settings, matcher, backend, fingerprint)


def _chosen(matcher: str) -> str:
    """The name that "auto" stands for here, and absolute paths."""
    if matcher.startswith(_ONNX):
        return f"{_ONNX}{Path(matcher.removeprefix(_ONNX)).absolute()}"
    return matcher_name(matcher)
