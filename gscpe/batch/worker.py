"""One worker: a Localizer and a folder of photos; a query in, a detail out."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping

import cv2

from gscpe.batch.details import Detail, failed_details, result_details
from gscpe.batch.fingerprint import map_fingerprint
from gscpe.batch.instructions import Instructions
from gscpe.batch.threads import limited_threads
from gscpe.closing import Closing
from gscpe.errors import InputError, MapError
from gscpe.localization import Localizer, PosePrior
from gscpe.scene import open_map, read_image_of
from gscpe.scene.query_list import Query


class Worker(Closing):
    """Localizes one query at a time."""

    def __init__(
        self,
        localizer: Localizer,
        image_folder: str | Path,
        priors: Mapping[str, PosePrior] | None = None,
    ) -> None:
        self._localizer = localizer
        self._priors = priors or {}
        self._image_folder = Path(image_folder)

    @classmethod
    def start(cls, instructions: Instructions, progress: bool = False) -> Worker:
        """Opens the map and makes a localizer.

        Args:
            instructions: what to open.
            progress: show a bar when the CPU rasterizer must be compiled first.

        Raises:
            MapError: the map is missing, damaged, or has changed since the instructions were
                given; or it has no references, and no photo has a prior.
            RenderError, ModelError, SettingsError, MissingDependencyError: as
                :class:`gscpe.localization.localizer.Localizer`.
        """
        folder, threads = instructions.map_folder, instructions.threads
        if map_fingerprint(folder) != instructions.fingerprint.map:
            raise MapError(f"map {folder} has changed since the work began; start again")
        with limited_threads(threads):
            if threads is not None:
                cv2.setNumThreads(threads)
            map_ = open_map(folder)
            if not len(map_.references) and not instructions.priors:
                raise MapError(f"{folder} has no reference photos to recognize places by")
            localizer = Localizer(
                map_, instructions.settings, instructions.matcher, instructions.backend, progress
            )
        return cls(localizer, instructions.image_folder, instructions.priors)

    @property
    def description(self) -> str:
        """What renders."""
        return self._localizer.renderer_description

    def localize(self, query: Query) -> Detail:
        """The query's detail; a photo that cannot be used has the status ``failed``.

        Raises:
            RenderError: rendering failed.
        """
        try:
            image = read_image_of(self._image_folder / query.name, query.camera)
            prior = self._priors.get(query.name)
            return result_details(query, self._localizer.localize(image, query.camera, prior))
        except InputError as error:
            return failed_details(query, str(error))

    def close(self) -> None:
        """Gives the renderer's memory back."""
        self._localizer.close()
