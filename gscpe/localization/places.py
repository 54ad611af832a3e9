# SPDX-License-Identifier: Apache-2.0
"""Where a photo may have been taken: a prior, and the places that reference photos show."""

from __future__ import annotations

from itertools import islice
from typing import Iterable, Iterator, Sequence

import numpy as np

from gscpe.errors import MapError
from gscpe.localization.prepared import PreparedPhoto
from gscpe.localization.settings import LocalizerSettings
from gscpe.localization.starts import (
    PosePrior,
    Start,
    different_places,
    near_the_prior_first,
)
from gscpe.retrieval import ReferenceIndex, RetrievedReference, open_describer
from gscpe.scene import Map

_MORE = 8
"""Times as many references are retrieved when those before showed too few different places."""


class Places:
    """Finds where to begin in one map.

    Args:
        map_: whose references are searched.
        settings: of the localizer.

    Raises:
        MapError, ModelError, MissingDependencyError: as :func:`gscpe.retrieval.open_describer`.
    """

    def __init__(self, map_: Map, settings: LocalizerSettings) -> None:
        self._references = map_.references
        self._settings = settings
        self._describer = open_describer(map_.descriptors, settings.retrieval_model)
        self._uses_xfeat = map_.descriptors.method == "vlad-xfeat"
        self._index = ReferenceIndex(map_.descriptors.descriptors, settings.index)

    def starts(
        self,
        query: PreparedPhoto,
        prior: PosePrior | None = None,
        names: Sequence[str] | None = None,
    ) -> Iterator[Start]:
        """Where to begin, best first, more places included; retrieval runs only when it is
        reached."""
        settings, references = self._settings, self._references
        if prior is not None:
            if (
                prior.translation_sigma <= settings.tracking_sigma
                and prior.rotation_sigma_degrees <= settings.tracking_sigma_degrees
            ):
                yield Start("tracking", prior.cam_from_world)
            if self.knows_rotation(prior):
                yield Start("prior", prior.cam_from_world)
        if not len(references):
            return
        poses, same_place = references.cam_from_world, settings.same_place
        ranking: Iterable[RetrievedReference]
        ranking = self._retrieve(query) if names is None else self._named(names)
        if prior is not None:
            reach = settings.prior_sigmas * prior.translation_sigma + same_place
            ranking = near_the_prior_first(ranking, poses, prior, reach)
        places = different_places(ranking, poses, same_place, settings.same_place_degrees)
        for reference in islice(places, settings.hypotheses + settings.more_places):
            name = references.names[reference.index]
            yield Start("reference", poses[reference.index], name)

    def knows_rotation(self, prior: PosePrior) -> bool:
        """Whether a render from the prior can show what the photo shows."""
        return prior.rotation_sigma_degrees <= self._settings.prior_degrees

    def _named(self, names: Sequence[str]) -> tuple[RetrievedReference, ...]:
        known = {name: index for index, name in enumerate(self._references.names)}
        missing = [name for name in names if name not in known]
        if missing:
            raise MapError(f"the map has no reference photo {missing[0]!r}")
        return tuple(RetrievedReference(known[name], np.nan) for name in names)

    def _retrieve(self, query: PreparedPhoto) -> Iterator[RetrievedReference]:
        """All reference photos, most similar first, as far as they are asked for; features that
        matching needs are not detected again to describe the photo."""
        query.begin()
        photo = query.well_lit
        features = query.xfeat_features() if self._uses_xfeat else None
        with query.clock.stage("retrieval"):
            described = self._describer.describe(photo.rgb, features, photo.valid)
        if np.any(described):
            with query.clock.stage("retrieval"):
                found = self._index.search(described, self._settings.retrieved)
            yield from found
            given = {reference.index for reference in found}
            while len(given) < len(self._references):
                with query.clock.stage("retrieval"):
                    found = self._index.search(described, _MORE * len(given))
                more = [reference for reference in found if reference.index not in given]
                if not more:
                    return  # an index with few probes does not reach all
                yield from more
                given |= {reference.index for reference in more}
