# SPDX-License-Identifier: Apache-2.0
"""The typed errors of gscpe.

Every error that a caller can act upon derives from :class:`GscpeError`, and its
message says what was wrong (which file, which value) and what to do about it.
A photo that cannot be localized is not an error: it is a result with a reason.
"""

from __future__ import annotations

import errno

_OPENCV_NO_MEMORY = -4


class GscpeError(Exception):
    """Base of all errors that gscpe raises on purpose."""


class InputError(GscpeError):
    """A file or a value that was given to gscpe cannot be used."""


class SplatError(InputError):
    """A Gaussian splat is missing, damaged, empty, or holds impossible values."""


class PhotoError(InputError):
    """A photo is missing, cannot be decoded, or has the wrong shape or type."""


class CameraError(InputError):
    """Camera intrinsics are malformed or do not fit the photo."""


class PoseError(InputError):
    """A pose is malformed, or a pose file cannot be read."""


class ColmapModelError(InputError):
    """A COLMAP model is missing, damaged, or does not name the photos it should."""


class MapError(InputError):
    """A map folder is missing, damaged, or was written by a newer gscpe."""


class ModelError(InputError):
    """A trained network is missing, damaged, or not of the expected form."""


class QueryListError(InputError):
    """A list of query photos cannot be read."""


class DatasetError(InputError):
    """A data set's folder lacks a file, or one of them has another form."""


class SettingsError(InputError):
    """A setting is out of its range, or settings contradict each other."""


class TrainingError(InputError):
    """Photos, poses or a checkpoint cannot be used for training."""


class ReconstructionError(InputError):
    """Photos or a video cannot be put together to a model of a place."""


class SequenceError(InputError):
    """Frames of a video, a list, a camera or a robot's recording (bag) cannot be read."""


class OutputError(GscpeError):
    """A result cannot be written where it was asked to be."""


class RenderError(GscpeError):
    """OpenGL is missing, too old, or reported a failure."""


class ClosedError(RenderError):
    """A renderer or a localizer was used after it had been closed, perhaps by another thread."""


class MissingDependencyError(GscpeError):
    """An optional package is needed for this and is not installed."""


class WorkerError(GscpeError):
    """Workers cannot be started or reached, or they die without having done anything."""


class ServiceError(GscpeError):
    """A service (``gscpe serve``) cannot be reached, is busy, or failed."""


def ran_out_of_memory(error: BaseException | None) -> bool:
    """Whether an error came of a want of memory: a MemoryError, what the system, OpenCV or Python's
    threads raise in place of one, or a typed error whose cause was one of these."""
    while error is not None:
        if isinstance(error, MemoryError) or "can't start new thread" in str(error):
            return True
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:
            return True
        if getattr(error, "code", None) == _OPENCV_NO_MEMORY and hasattr(error, "func"):
            return True
        error = error.__cause__
    return False
