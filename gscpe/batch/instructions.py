# SPDX-License-Identifier: Apache-2.0
"""What a worker is told: everything that it needs to localize, as small picklable data."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Mapping, Sequence

from gscpe.batch.fingerprint import (
    Fingerprint,
    map_fingerprint,
    maps_fingerprint,
    settings_fingerprint,
)
from gscpe.batch.priors import with_priors
from gscpe.batch.shelf import ShelfOrder, chosen_matcher, shelf_order
from gscpe.errors import SettingsError
from gscpe.localization import LocalizerSettings, PosePrior

TIMEOUT = 600.0
"""Seconds, hundreds of times what a photo takes: a worker that is slower hangs."""


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
        shelf: of several maps that each photo is looked for in (:class:`gscpe.batch.Building`);
            None: only in the one of ``map_folder``.
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
    shelf: ShelfOrder | None = None

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
        also: Sequence[str | Path] = (),
        memory: int | None = None,
    ) -> Instructions:
        """Instructions with absolute paths, the matcher chosen, and the maps as they are now.

        Args:
            map_folder: of the map.
            image_folder, settings, matcher, backend, priors, timeout: see the attributes.
            also: other maps that each photo is looked for in; then priors, which belong to one
                map, are refused.
            memory: bytes that the maps which a worker holds may take together, see
                :class:`gscpe.batch.ShelfOrder`.

        Raises:
            MapError: there is no map, or two have the same name.
            ModelError: the file of an ONNX matcher cannot be read.
            SettingsError: the timeout is not positive; or there are priors and several maps.
        """
        if not timeout > 0:
            raise SettingsError(f"the timeout must be positive, not {timeout} s")
        settings = settings or LocalizerSettings()
        if settings.retrieval_model is not None:
            settings = replace(settings, retrieval_model=Path(settings.retrieval_model).absolute())
        matcher = chosen_matcher(matcher)
        priors = priors or {}
        shelf = None
        if also:
            if priors:
                raise SettingsError("priors belong to one map, and several are given")
            folders = [str(folder) for folder in (map_folder, *also)]
            shelf = shelf_order(folders, settings, matcher, backend, memory)
        fingerprint = Fingerprint(
            map_fingerprint(map_folder) if shelf is None else maps_fingerprint(shelf.fingerprints),
            with_priors(settings_fingerprint(settings, matcher), priors),
        )
        return cls(
            *(Path(map_folder).absolute(), Path(image_folder).absolute(), settings, matcher),
            *(backend, fingerprint),
            priors=priors,
            timeout=timeout,
            shelf=shelf,
        )
