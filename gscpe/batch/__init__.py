# SPDX-License-Identifier: Apache-2.0
"""Localizes lists of photos: what is finished is on disk, and the work is done by a crew."""

from gscpe.batch.building import MAPS_TRIED, Building, PlacedResult
from gscpe.batch.choose import choose_workers, make_crew
from gscpe.batch.crew import Crew, SerialCrew
from gscpe.batch.details import Detail, read_details, result_details
from gscpe.batch.fingerprint import Fingerprint
from gscpe.batch.instructions import TIMEOUT, Instructions
from gscpe.batch.one_photo import OnePhoto, OneResult, localize_one
from gscpe.batch.priors import read_priors
from gscpe.batch.record import keep_a_copy, localize_list, localize_with
from gscpe.batch.shelf import Shelf, ShelfOrder, named_maps, shelf_order
from gscpe.batch.start import start_worker
from gscpe.batch.to_files import (
    ListFiles,
    check_outputs,
    localize_to_files,
    map_path,
    refuse_details,
    write_poses,
)
from gscpe.batch.worker import QueryWorker, Worker

__all__ = [
    "Building",
    "Crew",
    "Detail",
    "Fingerprint",
    "Instructions",
    "ListFiles",
    "MAPS_TRIED",
    "OnePhoto",
    "OneResult",
    "PlacedResult",
    "QueryWorker",
    "SerialCrew",
    "Shelf",
    "ShelfOrder",
    "TIMEOUT",
    "Worker",
    "check_outputs",
    "choose_workers",
    "keep_a_copy",
    "localize_list",
    "localize_one",
    "localize_to_files",
    "localize_with",
    "make_crew",
    "map_path",
    "named_maps",
    "read_details",
    "read_priors",
    "refuse_details",
    "result_details",
    "shelf_order",
    "start_worker",
    "write_poses",
]
