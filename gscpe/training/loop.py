# SPDX-License-Identifier: Apache-2.0
"""Trains a splat from photos with known poses (Kerbl et al., 3D Gaussian Splatting, 2023)."""

from __future__ import annotations

import logging
import time
from contextlib import closing
from pathlib import Path
from typing import Callable, Sequence

import numpy as np

from gscpe.arrays import Float64Array, IntArray
from gscpe.errors import CameraError, TrainingError
from gscpe.geometry.pose_error import camera_centres
from gscpe.geometry.se3 import check_transform
from gscpe.interrupts import interrupts_later
from gscpe.photos.photo import Photo
from gscpe.render.kernel_threads import KernelThreads
from gscpe.splats.gaussians import GaussianScene
from gscpe.training.checkpoint import (
    TrainingState,
    fingerprint,
    read_checkpoint,
    write_checkpoint,
)
from gscpe.training.exposure import Exposures
from gscpe.training.points import PointCloud, extent_of, first_gaussians
from gscpe.training.progress import Listener
from gscpe.training.schedule import Schedule
from gscpe.training.settings import TrainingSettings
from gscpe.training.trainer import Trainer

_log = logging.getLogger(__name__)

LEAST_PHOTOS = 3
_CHECKPOINT_SECONDS = 45.0


def train(
    photos: Sequence[Photo],
    cam_from_world: Float64Array,
    points: PointCloud,
    settings: TrainingSettings | None = None,
    progress: Listener | None = None,
    checkpoint: str | Path | None = None,
    *,
    resume: bool = False,
    threads: int | None = None,
    seen: Sequence[IntArray] | None = None,
) -> GaussianScene:
    """A splat that looks like the photos from where they were taken.

    With ``iterations`` it is the same to the last bit each time, whatever the number of threads,
    and also when it was interrupted and resumed. Ctrl-C takes effect between two iterations,
    after a checkpoint.

    Args:
        photos: at least three, pinhole; all are kept in memory.
        cam_from_world: (P, 4, 4), their poses.
        points: what to begin with, in the same frame.
        settings: how.
        progress: is told of every iteration.
        checkpoint: file that is written at the beginning and at least every minute, to resume
            from; it stays at the end.
        resume: go on from ``checkpoint``.
        threads: that compute; by default as many as there are cores to use.
        seen: indices of the points that each photo sees, see :meth:`PointCloud.seen_in`; without,
            depths are not regularized.

    Raises:
        TrainingError: there are too few photos, as many poses there are not, or other points
            are seen than there are; a checkpoint does not fit, or the training diverged.
        PoseError: a pose is not a rigid transform.
        CameraError: a photo has lens distortion, or is of another size than its camera.
        OutputError: a checkpoint cannot be written.
    """
    began = time.perf_counter()
    settings = settings or TrainingSettings()
    cam_from_world = _checked(photos, cam_from_world)
    seen = _checked_seen(seen, photos, points)
    path = None if checkpoint is None else Path(checkpoint)
    if resume and path is None:
        raise TrainingError("to resume, name the checkpoint")
    mark = fingerprint(photos, cam_from_world, points, seen, settings) if path else ""
    extent = _extent(cam_from_world, points)
    if resume and path is not None:
        state = read_checkpoint(path, mark, settings)
    else:
        state = _first_state(len(photos), points, extent, settings)
    if settings.depth_weight:
        known = np.mean([len(indices) for indices in seen]) if seen else 0.0
        _log.info("depths of %.0f points in a photo, on average, are looked at", known)
    began -= state.schedule.seconds

    def save() -> None:
        if path is not None:
            write_checkpoint(path, state, mark)

    with closing(KernelThreads(threads)) as pool:
        trainer = Trainer(photos, cam_from_world, extent, state, settings, pool, points, seen)
        with interrupts_later() as interrupts:
            if not resume:  # a full disk is found now, and not in a minute
                save()
            _iterate(trainer, state.schedule, began, interrupts, progress, save)
            save()
        if not state.schedule.is_done:  # and the program's own handler let it go on
            raise KeyboardInterrupt
    _log.info("trained %d iterations in %.0f s", state.schedule.iteration, state.schedule.seconds)
    return trainer.scene()


def _iterate(
    trainer: Trainer,
    schedule: Schedule,
    began: float,
    interrupts: Sequence[int],
    progress: Listener | None,
    save: Callable[[], None],
) -> None:
    """Until the schedule is done or there is an interrupt; saves now and then."""
    saved = time.perf_counter()
    while not schedule.is_done and not interrupts:
        before = time.perf_counter()
        trainer.step()
        now = time.perf_counter()
        schedule.advance(now - began, now - before)
        trainer.follow_schedule()
        if progress is not None:
            progress(trainer.progress())
        if now - saved > _CHECKPOINT_SECONDS:
            save()
            saved = time.perf_counter()


def _first_state(
    photos: int, points: PointCloud, extent: float, settings: TrainingSettings
) -> TrainingState:
    parameters = first_gaussians(points, extent, settings)
    return TrainingState(
        parameters=parameters,
        exposures=Exposures.neutral(photos),
        schedule=Schedule(settings),
        screen_gradients=np.zeros(len(parameters), dtype=np.float32),
        times_seen=np.zeros(len(parameters), dtype=np.int32),
    )


def _checked(photos: Sequence[Photo], cam_from_world: Float64Array) -> Float64Array:
    if len(photos) < LEAST_PHOTOS:
        raise TrainingError(
            f"{len(photos)} photos are too few: at least {LEAST_PHOTOS} from different places "
            "are needed"
        )
    if len(photos) != len(cam_from_world):
        raise TrainingError(f"{len(photos)} photos, but {len(cam_from_world)} poses")
    for number, photo in enumerate(photos):
        if not photo.camera.is_pinhole:
            raise CameraError(f"photo {number} has lens distortion; undistort it with to_photo")
        photo.camera.check_fits(photo.rgb.shape, f"photo {number}")
    return np.stack(
        [
            check_transform(pose, f"cam_from_world of photo {i}")
            for i, pose in enumerate(cam_from_world)
        ]
    )


def _checked_seen(
    seen: Sequence[IntArray] | None, photos: Sequence[Photo], points: PointCloud
) -> Sequence[IntArray] | None:
    if seen is None:
        return None
    if len(seen) != len(photos):
        raise TrainingError(f"{len(photos)} photos, but points that {len(seen)} see")
    for number, indices in enumerate(seen):
        if len(indices) and not 0 <= indices.min() <= indices.max() < len(points.positions):
            raise TrainingError(
                f"photo {number} sees points that are not among the {len(points.positions)}"
            )
    return seen


def _extent(cam_from_world: Float64Array, points: PointCloud) -> float:
    """Of the cameras; half the distance to the points where they stand close together."""
    centres = camera_centres(cam_from_world)
    far = np.median(np.linalg.norm(points.positions - centres.mean(axis=0), axis=1))
    return max(extent_of(cam_from_world), 0.5 * float(far), 1e-9)
