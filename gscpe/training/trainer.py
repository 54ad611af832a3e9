# SPDX-License-Identifier: Apache-2.0
"""An iteration of training: render, compare, take the gradients back, update."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from gscpe.arrays import Float64Array, IntArray
from gscpe.errors import TrainingError
from gscpe.photos.photo import Photo, resized_photo
from gscpe.render.kernel_threads import KernelThreads, in_parts
from gscpe.splats.gaussians import GaussianScene
from gscpe.training.adam import CORRECTIONS, update_gaussians
from gscpe.training.checkpoint import TrainingState
from gscpe.training.densification import is_kept, split, to_split
from gscpe.training.depth import PointDepths, depth_loss
from gscpe.training.loss import photo_loss
from gscpe.training.parameters import MOMENTS
from gscpe.training.points import PointCloud
from gscpe.training.progress import Progress
from gscpe.training.rasterizer import DepthGradient, ForwardPass, Gradients, TrainingRasterizer
from gscpe.training.settings import TrainingSettings

_FOLD_EVERY = 100
_TASK = 4096  # slots
_PSNR_MEMORY = 0.02
_ORDER, _BACKGROUND = 1, 2  # streams of random numbers


class Trainer:
    """One iteration after the other. :func:`train` adds checkpoints and interruption.

    Args:
        photos, cam_from_world, points, seen, settings: as for :func:`train`.
        extent: of the cameras, units of the scene.
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
        points: PointCloud | None = None,
        seen: Sequence[IntArray] | None = None,
    ) -> None:
        self._photos = photos
        self._poses = cam_from_world
        self._extent = extent
        self._state = state
        self._settings = settings
        self._threads = threads
        self._points = points
        self._seen = seen
        self._rasterizer = TrainingRasterizer(threads, settings.antialiased)
        self._small: list[Photo] | None = None

    def step(self) -> None:
        """Learns from one photo."""
        state, settings = self._state, self._settings
        number = state.schedule.iteration
        index = self.photo_of(number)
        photo = self.sized(index)
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
            gaussians,
            forward,
            loss.rgb_gradient,
            loss.opacity_gradient,
            self._depth_gradient(index, photo, forward),
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

    def photo_of(self, number: int) -> int:
        """Each photo once, in random order, then all again in another."""
        turn, place = divmod(number, len(self._photos))
        order = np.random.default_rng((self._settings.seed, _ORDER, turn))
        return int(order.permutation(len(self._photos))[place])

    def sized(self, index: int) -> Photo:
        """A photo as large as it is used at the moment."""
        if not self._state.schedule.is_small:
            self._small = None
            return self._photos[index]
        if self._small is None:
            self._small = [resized_photo(photo, 0.5) for photo in self._photos]
        return self._small[index]

    def _depth_gradient(
        self, index: int, photo: Photo, forward: ForwardPass
    ) -> DepthGradient | None:
        """Of the points that the photo sees."""
        settings = self._settings
        if not settings.depth_weight or self._seen is None or self._points is None:
            return None
        positions = self._points.positions[self._seen[index]]
        depths = PointDepths.of(positions, photo.camera, self._poses[index], photo.valid)
        fallen = settings.depth_weight_end**self._state.schedule.share
        return depth_loss(forward.view, depths, settings.depth_weight * fallen)[1]

    def _update(self, gradients: Gradients, half_side: float) -> None:
        state, settings = self._state, self._settings
        parameters, share = state.parameters, state.schedule.share
        rates = np.empty(MOMENTS, dtype=np.float32)
        rates[:3] = settings.position_rate * self._extent * settings.position_rate_end**share
        fallen = settings.rates_end**share
        rates[3:6] = settings.scale_rate * fallen
        rates[6:10] = settings.rotation_rate * fallen
        rates[10] = settings.opacity_rate * fallen
        rates[11:] = settings.colour_rate * fallen
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
            np.float32(settings.colour_rate * settings.harmonics_rate * fallen),
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
            raise TrainingError("all Gaussians faded away; do the poses belong to these photos?")
        parameters = state.parameters.take(np.flatnonzero(kept))
        if round_ <= settings.densify_rounds:
            seen = np.maximum(state.times_seen[kept], 1)
            scores = np.asarray(state.screen_gradients[kept] / seen, dtype=np.float32)
            parameters = split(parameters, to_split(scores, round_, settings))
        state.parameters = parameters.in_spatial_order()
        state.forget_gradients()
