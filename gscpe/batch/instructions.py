"""What a worker is told: everything that it needs to localize, as small picklable data."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Mapping

from gscpe.batch.fingerprint import Fingerprint, map_fingerprint, settings_fingerprint
from gscpe.batch.priors import with_priors
from gscpe.localization import LocalizerSettings, PosePrior
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
        priors: where photos probably were taken, by name; others begin with retrieval.
    """

    map_folder: Path
    image_folder: Path
    settings: LocalizerSettings
    matcher: str
    backend: str
    fingerprint: Fingerprint
    threads: int | None = None
    priors: Mapping[str, PosePrior] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        map_folder: str | Path,
        image_folder: str | Path,
        settings: LocalizerSettings | None = None,
        matcher: str = "auto",
        backend: str = "auto",
        priors: Mapping[str, PosePrior] | None = None,
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
        priors = priors or {}
        fingerprint = Fingerprint(
            map_fingerprint(map_folder),
            with_priors(settings_fingerprint(settings, matcher), priors),
        )
        folders = Path(map_folder).absolute(), Path(image_folder).absolute()
        return cls(*folders, settings, matcher, backend, fingerprint, priors=priors)


def _chosen(matcher: str) -> str:
    """The name that "auto" stands for here, and absolute paths."""
    if matcher.startswith(_ONNX):
        return f"{_ONNX}{Path(matcher.removeprefix(_ONNX)).absolute()}"
    return matcher_name(matcher)
