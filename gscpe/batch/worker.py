# SPDX-License-Identifier: Apache-2.0
"""One worker: a Localizer and a folder of photos; a query in, a detail out."""

from __future__ import annotations

import os
from abc import abstractmethod
from contextlib import contextmanager
from pathlib import Path
from typing import Iterator, Mapping

import cv2

from gscpe.arrays import UInt8Array
from gscpe.batch.details import Detail, failed_details, result_details
from gscpe.batch.fingerprint import map_fingerprint, photo_fingerprint
from gscpe.batch.instructions import Instructions
from gscpe.closing import Closing
from gscpe.cores import VARIABLE
from gscpe.errors import InputError, MapError, ran_out_of_memory
from gscpe.localization import Localizer, PosePrior
from gscpe.photos import read_image_of
from gscpe.scene import open_map
from gscpe.scene.query_list import Query

_VARIABLES = (
    VARIABLE,  # the CPU rasterizer, onnxruntime
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"),
    *("NUMBA_NUM_THREADS", "LP_NUM_THREADS"),  # the last one: Mesa's software OpenGL
)


class QueryWorker(Closing):
    """Localizes one query at a time.

    Args:
        image_folder: that the queries' names are relative to.
    """

    def __init__(self, image_folder: str | Path) -> None:
        self.image_folder = Path(image_folder)

    @property
    @abstractmethod
    def description(self) -> str:
        """What renders."""

    @abstractmethod
    def found(self, query: Query, image: UInt8Array, photo: str | None) -> Detail:
        """What is found of a photo that was read, with the fingerprint of its file."""

    def work(self, job: Query, talk: object = None) -> Detail:
        """As :meth:`localize`: what :class:`gscpe.batch.in_process.Works` are given."""
        return self.localize(job)

    def localize(self, query: Query) -> Detail:
        """The query's detail; a photo that cannot be used has the status ``failed``.

        Raises:
            RenderError: rendering failed.
        """
        path = self.image_folder / query.name
        try:
            photo = photo_fingerprint(path)
            return self.found(query, read_image_of(path, query.camera), photo)
        except InputError as error:
            return failed_details(query, str(error))
        except Exception as error:
            if not ran_out_of_memory(error):
                raise
            return failed_details(query, f"there is not enough memory for {path} ({error})")


class Worker(QueryWorker):
    """Localizes in one map; see :class:`QueryWorker`.

    Args:
        localizer: of the map; it is closed with the worker.
        image_folder: that the queries' names are relative to.
        priors: where photos probably were taken, by name.
    """

    def __init__(
        self,
        localizer: Localizer,
        image_folder: str | Path,
        priors: Mapping[str, PosePrior] | None = None,
    ) -> None:
        super().__init__(image_folder)
        self._localizer = localizer
        self._priors = priors or {}

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
            raise MapError(f"map {folder} has changed since the start; start again")
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
        return self._localizer.renderer_description

    def found(self, query: Query, image: UInt8Array, photo: str | None) -> Detail:
        prior = self._priors.get(query.name)
        result = self._localizer.localize(image, query.camera, prior)
        return result_details(query, result, photo)

    def close(self) -> None:
        """Gives the renderer's memory back."""
        self._localizer.close()


@contextmanager
def limited_threads(threads: int | None) -> Iterator[None]:
    """Sets the environment that libraries read when they are loaded, and processes that are
    started meanwhile inherit. None: leaves it."""
    if threads is None:
        yield
        return
    before = {name: os.environ.get(name) for name in _VARIABLES}
    os.environ.update(dict.fromkeys(_VARIABLES, str(threads)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
