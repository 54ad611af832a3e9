# SPDX-License-Identifier: Apache-2.0
"""What a training needs to go on as if nothing had happened, in one file."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import tempfile
import zipfile
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Sequence

import numpy as np

from gscpe.arrays import Float32Array, Float64Array, IntArray
from gscpe.errors import OutputError, TrainingError
from gscpe.given import parse_json
from gscpe.photos.photo import Photo
from gscpe.training.exposure import Exposures
from gscpe.training.parameters import Parameters
from gscpe.training.points import PointCloud
from gscpe.training.schedule import Schedule
from gscpe.training.settings import TrainingSettings

_VERSION = 1
_SCHEDULE = ("iteration", "share", "seconds", "small_cost", "large_cost")


@dataclass
class TrainingState:
    """All that changes from one iteration to the next.

    Attributes:
        parameters: the Gaussians.
        exposures: of the photos.
        schedule: how far it is.
        screen_gradients: (N,) float32, sums of the gradients' lengths since the last round.
        times_seen: (N,) int32, of how many.
        rounds: of densification that are done.
        psnr: a running mean over the photos seen last, dB.
    """

    parameters: Parameters
    exposures: Exposures
    schedule: Schedule
    screen_gradients: Float32Array
    times_seen: np.ndarray[tuple[int, ...], np.dtype[np.int32]]
    rounds: int = 0
    psnr: float = 0.0

    def forget_gradients(self) -> None:
        """After the Gaussians have become others."""
        self.screen_gradients = np.zeros(len(self.parameters), dtype=np.float32)
        self.times_seen = np.zeros(len(self.parameters), dtype=np.int32)


def fingerprint(
    photos: Sequence[Photo],
    cam_from_world: Float64Array,
    points: PointCloud,
    seen: Sequence[IntArray] | None,
    settings: TrainingSettings,
) -> str:
    """A digest of what a training is made of. The minutes are not part of it: they may be
    prolonged."""
    digest = hashlib.sha256()
    chosen = {k: v for k, v in asdict(settings).items() if k != "minutes"}
    digest.update(json.dumps(chosen, sort_keys=True).encode())
    for photo in photos:
        digest.update(photo.camera.colmap_text().encode())
        digest.update(photo.rgb.tobytes())
    for array in (cam_from_world, points.positions, points.colours, *(seen or ())):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def write_checkpoint(path: Path, state: TrainingState, mark: str) -> None:
    """Writes beside the file and renames, so that there is always a whole one.

    Raises:
        OutputError: it cannot be written. The checkpoint before is still there.
    """
    header = {
        "version": _VERSION,
        "fingerprint": mark,
        "rounds": state.rounds,
        "psnr": state.psnr,
        **{name: getattr(state.schedule, name) for name in _SCHEDULE},
    }
    arrays: dict[str, Any] = {"header": np.array(json.dumps(header))}
    for part in ("parameters", "exposures"):
        whole = getattr(state, part)
        arrays.update({f"{part}.{f.name}": getattr(whole, f.name) for f in fields(whole)})
    arrays["screen_gradients"], arrays["times_seen"] = state.screen_gradients, state.times_seen
    name = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **arrays)
        os.replace(name, path)
    except BaseException as error:
        if name is not None:
            Path(name).unlink(missing_ok=True)
        if not isinstance(error, OSError):
            raise
        hint = ""
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            hint = "; free some space, and continue from the previous checkpoint with --resume"
        raise OutputError(
            f"the training's checkpoint {path} cannot be written: {error.strerror}{hint}"
        ) from error


def read_checkpoint(path: Path, mark: str, settings: TrainingSettings) -> TrainingState:
    """The state that was written last.

    Raises:
        TrainingError: there is none, it is damaged, or it is of other photos, points or settings.
    """
    if not path.is_file():
        raise TrainingError(f"there is no checkpoint {path} to resume from; start without --resume")
    try:
        with np.load(path, allow_pickle=False) as stored:
            header = parse_json(str(stored["header"]))
            arrays = {name: stored[name] for name in stored.files if name != "header"}
        if header["version"] != _VERSION:
            raise TrainingError(
                f"checkpoint {path} was written by another version of gscpe; start without --resume"
            )
        parts = {
            part: {
                name.split(".")[1]: array
                for name, array in arrays.items()
                if name.startswith(f"{part}.")
            }
            for part in ("parameters", "exposures")
        }
        state = TrainingState(
            parameters=Parameters(**parts["parameters"]),
            exposures=Exposures(**parts["exposures"]),
            schedule=Schedule(settings, **{name: header[name] for name in _SCHEDULE}),
            screen_gradients=arrays["screen_gradients"],
            times_seen=arrays["times_seen"],
            rounds=header["rounds"],
            psnr=header["psnr"],
        )
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise TrainingError(
            f"checkpoint {path} is damaged ({error}); start without --resume"
        ) from error
    if header["fingerprint"] != mark:
        raise TrainingError(
            f"checkpoint {path} belongs to other photos, points or settings; give the same ones, "
            "or start without --resume"
        )
    return state
