"""Localizes lists of photos: what is finished is on disk, and the work is done by a crew."""

from gscpe.batch.choose import choose_workers, make_crew
from gscpe.batch.crew import Crew
from gscpe.batch.details import Detail, read_details, result_details
from gscpe.batch.fingerprint import Fingerprint
from gscpe.batch.instructions import Instructions
from gscpe.batch.outputs import check_outputs, write_poses
from gscpe.batch.priors import read_priors
from gscpe.batch.record import localize_list, localize_with
from gscpe.batch.serial_crew import SerialCrew
from gscpe.batch.to_files import ListFiles, localize_to_files
from gscpe.batch.worker import Worker

__all__ = [
    "Crew",
    "Detail",
    "Fingerprint",
    "Instructions",
    "ListFiles",
    "SerialCrew",
    "Worker",
    "check_outputs",
    "choose_workers",
    "localize_list",
    "localize_to_files",
    "localize_with",
    "make_crew",
    "read_details",
    "read_priors",
    "result_details",
    "write_poses",
]
