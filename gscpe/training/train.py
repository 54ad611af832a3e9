"""Trains a splat from photos with known poses (Kerbl et al., 3D Gaussian Splatting, 2023)."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import TrainingError
from gscpe.geometry.se3 import check_transform
from gscpe.render.kernel_threads import KernelThreads, in_parts, interrupts_later
from gscpe.scene.gaussians import GaussianScene
from gscpe.scene.photo import Photo, resized_photo
from gscpe.training.adam import CORRECTIONS, update_gaussians
from gscpe.training.checkpoint import (
    TrainingState,
    fingerprint,
    read_checkpoint,
    write_checkpoint,
)
from gscpe.training.densification import is_kept, split, to_split
from gscpe.training.exposure import Exposures
from gscpe.training.loss import photo_loss
from gscpe.training.parameters import MOMENTS
from gscpe.training.points import PointCloud, extent_of, first_gaussians
from gscpe.training.progress import Listener, Progress
from gscpe.training.rasterizer import Gradients, TrainingRasterizer
from gscpe.training.schedule import Schedule
from gscpe.training.settings import TrainingSettings

_log = logging.getLogger(__name__)

LEAST_PHOTOS = 3
_CHECKPOINT_SECONDS = 45.0
_FOLD_EVERY = 100
_TASK = 4096  # slots
_PSNR_MEMORY = 0.02
_ORDER, _BACKGROUND = 1, 2  # streams of random numbers


def train(
    photos: Sequence[Photo],
    cam_from_world: Float64Array,
    points: PointCloud,
    settings: TrainingSettings | None = None,
    progress: Listener | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    threads: int | None = None,
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

    Raises:
        TrainingError: there are too few photos, as many poses there are not, a checkpoint does not
            fit, or the training diverged.
        PoseError: a pose is not a rigid transform.
        OutputError: a checkpoint cannot be written.
    """
    begin = time.perf_counter()
    settings = settings or TrainingSettings()
    cam_from_world = _checked(photos, cam_from_world)
    path = None if checkpoint is None else Path(checkpoint)
    if resume and path is None:
        raise TrainingError("to resume, name the checkpoint")
    mark = fingerprint(photos, cam_from_world, points, settings) if path else ""
    extent = _extent(cam_from_world, points)
    if resume and path is not None:
        state = read_checkpoint(path, mark, settings)
    else:
        parameters = first_gaussians(points, extent, settings)
        state = TrainingState(
            parameters=parameters,
            exposures=Exposures.neutral(len(photos)),
            schedule=Schedule(settings),
            screen_gradients=np.zeros(len(parameters), dtype=np.float32),
            times_seen=np.zeros(len(parameters), dtype=np.int32),
        )
    begin -= state.schedule.seconds
    pool = KernelThreads(threads)
    trainer = Trainer(photos, cam_from_world, extent, state, settings, pool)
    try:
        with interrupts_later() as interrupts:
            if path is not None and not resume:
                write_checkpoint(path, state, mark)  # now, and not in a minute, is a disk found full
            written = time.perf_counter()
            while not state.schedule.is_done and not interrupts:
                before = time.perf_counter()
                trainer.step()
                now = time.perf_counter()
                state.schedule.advance(now - begin, now - before)
                trainer.follow_schedule()
                if progress is not None:
                    progress(trainer.progress())
                if path is not None and now - written > _CHECKPOINT_SECONDS:
                    write_checkpoint(path, state, mark)
                    written = time.perf_counter()
            if path is not None:
                write_checkpoint(path, state, mark)
    finally:
        pool.close()
    _log.info("trained %d iterations in %.0f s", state.schedule.iteration, state.schedule.seconds)
    return trainer.scene()


class Trainer:
    """One iteration after the other. :func:`train` adds checkpoints and interruption.

    Args:
        photos, cam_from_world, settings: as for :func:`train`.
        extent: of the cameras, map units.
        state: where to begin; it is changed.
        threads: run the loops.
    """

    def __init__(
        self,
        photos: Sequence[Photo],
        cam_from_world: Float64Array,
        extent: float,
        state: TrainingState,
        settings: TrainingSettings,
        threads: KernelThreads,
    ) -> None:
        self._photos = photos
        self._poses = cam_from_world
        self._extent = extent
        self._state = state
        self._settings = settings
        self._threads = threads
        self._rasterizer = TrainingRasterizer(threads, settings.antialiased)
        self._small: list[Photo] | None = None

    def step(self) -> None:
        """Learns from one photo."""
        state, settings = self._state, self._settings
        number = state.schedule.iteration
        index = self._photo_of(number)
        photo = self._sized(index)
        background = np.random.default_rng((settings.seed, _BACKGROUND, number)).uniform(size=3)
        gaussians = state.parameters.as_rendered()
        forward = self._rasterizer.forward(gaussians, photo.camera, self._poses[index])
        log_gain, bias = state.exposures.values[index]
        loss = photo_loss(
            self._threads,
            forward.view,
            photo.rgb,
            photo.valid,
            background.astype(np.float32),
            log_gain,
            bias,
            settings.ssim_weight,
        )
        gradients = self._rasterizer.backward(
            gaussians, forward, loss.rgb_gradient, loss.opacity_gradient
        )
        self._update(gradients, 0.5 * max(photo.camera.width, photo.camera.height))
        if settings.exposure_rate:
            rate = settings.exposure_rate * 0.1**state.schedule.share
            state.exposures.update(index, loss.log_gain_gradient, loss.bias_gradient, rate)
            if (number + 1) % _FOLD_EVERY == 0:
                state.exposures.fold_mean_into(state.parameters)
        psnr = -10.0 * float(np.log10(max(loss.squared, 1e-10)))
        state.psnr += (_PSNR_MEMORY if number else 1.0) * (psnr - state.psnr)

    def follow_schedule(self) -> None:
        """Densification and higher degrees, where they are due."""
        state, settings = self._state, self._settings
        share = state.schedule.share
        degree = settings.sh_degree_at(share)
        if state.parameters.sh.shape[1] != (degree + 1) ** 2:
            state.parameters = state.parameters.with_degree(degree)
        due = settings.round_at(share)
        if due > state.rounds and not state.schedule.is_done:
            self._densify(due)
            state.rounds = due

    def progress(self) -> Progress:
        schedule = self._state.schedule
        return Progress(
            schedule.iteration,
            schedule.share,
            len(self._state.parameters),
            self._state.psnr,
            schedule.seconds_left(),
        )

    def scene(self) -> GaussianScene:
        """The splat, without those that no view can show."""
        parameters = self._state.parameters
        if not all(
            np.all(np.isfinite(array)) for array in (parameters.means, parameters.sh)
        ):  # pragma: no cover - clipped steps do not get there
            raise TrainingError("the training diverged; lower the learning rates")
        shown = parameters.take(np.flatnonzero(parameters.opacities >= 1.0 / 255.0))
        return shown.scene(self._settings.sh_degree, self._settings.antialiased)

    def _photo_of(self, number: int) -> int:
        """Each photo once, in random order, then all again in another."""
        turn, place = divmod(number, len(self._photos))
        order = np.random.default_rng((self._settings.seed, _ORDER, turn))
        return int(order.permutation(len(self._photos))[place])

    def _sized(self, index: int) -> Photo:
        if not self._state.schedule.is_small:
            self._small = None
            return self._photos[index]
        if self._small is None:
            self._small = [resized_photo(photo, 0.5) for photo in self._photos]
        return self._small[index]

    def _update(self, gradients: Gradients, half_side: float) -> None:
        state, settings = self._state, self._settings
        parameters, share = state.parameters, state.schedule.share
        rates = np.empty(MOMENTS, dtype=np.float32)
        rates[:3] = settings.position_rate * self._extent * settings.position_rate_end**share
        rates[3:6] = settings.scale_rate * (1.0 if share < 0.7 else 0.5)
        rates[6:10] = settings.rotation_rate
        rates[10] = settings.opacity_rate
        rates[11:] = settings.colour_rate
        shown = max(sum(end - begin for begin, end in gradients.used), 1)
        self._threads.run(
            update_gaussians,
            [
                (begin + first, begin + last)
                for begin, end in gradients.used
                for first, last in in_parts(end - begin, _TASK)
            ],
            gradients.keys,
            gradients.by_slot,
            rates,
            np.float32(settings.colour_rate * settings.harmonics_rate),
            np.float32(settings.opacity_weight / shown),
            np.float32(settings.scale_weight / (shown * 3 * self._extent)),
            np.float32(half_side),
            CORRECTIONS,
            parameters.means,
            parameters.log_scales,
            parameters.scales,
            parameters.quaternions,
            parameters.logits,
            parameters.opacities,
            parameters.sh,
            parameters.first,
            parameters.second,
            parameters.steps,
            state.screen_gradients,
            state.times_seen,
        )

    def _densify(self, round_: int) -> None:
        """Drops what is not worth its place, and splits where the screen asks for it."""
        state, settings = self._state, self._settings
        kept = is_kept(state.parameters, self._extent, settings)
        if not np.any(kept):
            raise TrainingError("all Gaussians faded away; are photos and poses of one place?")
        parameters = state.parameters.take(np.flatnonzero(kept))
        if round_ <= settings.densify_rounds:
            scores = (state.screen_gradients / np.maximum(state.times_seen, 1))[kept]
            parameters = split(parameters, to_split(scores, round_, settings))
        state.parameters = parameters.in_spatial_order()
        state.forget_gradients()


def _checked(photos: Sequence[Photo], cam_from_world: Float64Array) -> Float64Array:
    if len(photos) < LEAST_PHOTOS:
        raise TrainingError(
            f"{len(photos)} photos are too few: at least {LEAST_PHOTOS} from different places "
            "are needed"
        )
    if len(photos) != len(cam_from_world):
        raise TrainingError(f"{len(photos)} photos, but {len(cam_from_world)} poses")
    return np.stack(
        [
            check_transform(pose, f"cam_from_world of photo {i}")
            for i, pose in enumerate(cam_from_world)
        ]
    )


def _extent(cam_from_world: Float64Array, points: PointCloud) -> float:
    """Of the cameras; a twentieth of the distance to the points where they all stand together."""
    centres = -np.einsum("nji,nj->ni", cam_from_world[:, :3, :3], cam_from_world[:, :3, 3])
    far = np.median(np.linalg.norm(points.positions - centres.mean(axis=0), axis=1))
    return max(extent_of(cam_from_world), 0.05 * float(far), 1e-9)
