# SPDX-License-Identifier: Apache-2.0
"""A photo looked for in several maps, as the rooms of a building: retrieval over all references
first, and only the maps that it names are opened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gscpe.batch.one_photo import OnePhoto, OneResult, localize_one
from gscpe.batch.shelf import Shelf
from gscpe.closing import Closing
from gscpe.errors import MapError
from gscpe.localization import Observer
from gscpe.photos.image_array import check_image
from gscpe.retrieval.several import SeveralDescribers
from gscpe.scene.map_folder import open_references

MAPS_TRIED = 3
"""The photo is looked for in so many, the most similar first."""


@dataclass(frozen=True, eq=False)
class PlacedResult:
    """Where a photo was found, or not.

    Attributes:
        map: whose world the pose belongs to; where it was not localized, the most similar one.
        tried: names of the maps that it was looked for in, in order.
        found: of this map.
    """

    map: str
    tried: tuple[str, ...]
    found: OneResult

    def as_json(self) -> dict[str, Any]:
        """As :meth:`OneResult.as_json`, with ``map_name`` and ``maps_tried``."""
        return self.found.as_json() | self.as_fields()

    def as_fields(self) -> dict[str, Any]:
        """``map_name`` and ``maps_tried`` alone."""
        return {"map_name": self.map, "maps_tried": list(self.tried)}


class Building(Closing):
    """Holds the references' descriptors of all maps, and some of the maps.

    Args:
        shelf: that opens the maps; it is not closed.

    Raises:
        MapError: no map has references, or one of them is damaged.
        ModelError, MissingDependencyError: as :func:`gscpe.retrieval.open_describer`.
    """

    def __init__(self, shelf: Shelf) -> None:
        self._shelf = shelf
        known = {}
        for name, folder in shelf.order.folders.items():
            references, descriptors = open_references(folder)
            if len(references):
                known[name] = descriptors
        if not known:
            raise MapError("none of the maps has reference photos to recognize a place by")
        self._descriptors = {name: each.descriptors for name, each in known.items()}
        model = shelf.order.settings.retrieval_model
        self._describers = SeveralDescribers(list(known.values()), model)

    def ranked(self, photo: OnePhoto) -> tuple[str, ...]:
        """Names of the maps by their most similar reference, the most similar first.

        Raises:
            PhotoError: as :meth:`gscpe.Localizer.localize`.
        """
        image = check_image(photo.image, transparent=True)
        valid = None if image.shape[2] == 3 else image[:, :, 3] > 0
        described = self._describers.describe(np.ascontiguousarray(image[:, :, :3]), valid)
        alike = {
            name: float(np.max(descriptors @ vector))
            for (name, descriptors), vector in zip(
                self._descriptors.items(), described, strict=True
            )
        }
        return tuple(sorted(alike, key=lambda name: -alike[name]))

    def localize(self, photo: OnePhoto, observer: Observer | None = None) -> PlacedResult:
        """Looks for a photo in the most similar maps, until it is found.

        Raises:
            GscpeError: as :func:`gscpe.batch.localize_one`.
        """
        results: dict[str, OneResult] = {}
        for name in self.ranked(photo)[:MAPS_TRIED]:
            results[name] = localize_one(self._shelf.localizer(name), photo, None, observer)
            if results[name].localized:
                return PlacedResult(name, tuple(results), results[name])
        first = next(iter(results))
        return PlacedResult(first, tuple(results), results[first])

    def close(self) -> None:
        """The shelf stays open."""
