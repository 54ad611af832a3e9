# SPDX-License-Identifier: Apache-2.0
"""The worker that instructions ask for: of one map, or of several."""

from __future__ import annotations

from pathlib import Path

import cv2

from gscpe.arrays import UInt8Array
from gscpe.batch.building import Building
from gscpe.batch.details import Detail, result_details
from gscpe.batch.instructions import Instructions
from gscpe.batch.one_photo import OnePhoto
from gscpe.batch.shelf import Shelf, ShelfOrder
from gscpe.batch.worker import QueryWorker, Worker, limited_threads
from gscpe.render import choose_backend
from gscpe.scene.query_list import Query


def start_worker(instructions: Instructions, progress: bool = False) -> QueryWorker:
    """Opens what is needed.

    Args:
        instructions: what to open.
        progress: show a bar when the CPU rasterizer must be compiled first.

    Raises:
        GscpeError: as :meth:`gscpe.batch.Worker.start` and :class:`BuildingWorker`.
    """
    if instructions.shelf is None:
        return Worker.start(instructions, progress)
    if instructions.threads is not None:
        cv2.setNumThreads(instructions.threads)
    return BuildingWorker(instructions.shelf, instructions.image_folder, instructions.threads)


class BuildingWorker(QueryWorker):
    """Localizes in several maps, which are opened when they are needed.

    Args:
        order: of the maps.
        image_folder: that the queries' names are relative to.
        threads: None: one for each core.

    Raises:
        MapError, ModelError, MissingDependencyError: as :class:`gscpe.batch.Building`.
        RenderError, SettingsError: as gscpe.render.choose_backend.
    """

    def __init__(
        self, order: ShelfOrder, image_folder: str | Path, threads: int | None = None
    ) -> None:
        super().__init__(image_folder)
        self._threads = threads
        self._renderer = choose_backend(order.backend)
        self._shelf = Shelf(order)
        with limited_threads(threads):
            self._building = Building(self._shelf)

    @property
    def description(self) -> str:
        return f"{len(self._shelf.order.folders)} maps, renderer {self._renderer}"

    def found(self, query: Query, image: UInt8Array, photo: str | None) -> Detail:
        with limited_threads(self._threads):  # it may open a map
            placed = self._building.localize(OnePhoto(query.name, image, query.camera))
        result = placed.found.result
        assert result is not None  # its camera is known
        return result_details(query, result, photo) | placed.as_fields()

    def close(self) -> None:
        self._shelf.close()
