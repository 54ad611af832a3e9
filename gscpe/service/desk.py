# SPDX-License-Identifier: Apache-2.0
"""What a worker process of the service does: photos, renders and views from above."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from typing import Any

import cv2

from gscpe.arrays import BoolArray, Float64Array
from gscpe.batch.building import Building
from gscpe.batch.in_process import StoppedError, Talk
from gscpe.batch.one_photo import OnePhoto, localize_one
from gscpe.batch.shelf import Shelf, ShelfOrder
from gscpe.closing import Closing
from gscpe.coarse import AbsolutePose
from gscpe.errors import RenderError, ran_out_of_memory
from gscpe.geometry.camera import Camera
from gscpe.localization import Attempt, Localizer, Observer, PosePrior
from gscpe.matching import Matches
from gscpe.photos import to_uint8
from gscpe.render import RenderedView
from gscpe.report import map_from_above
from gscpe.service.problem import Problem, failed, problem_of, too_large

_log = logging.getLogger(__name__)

DECODING, WORKING = "decoding", "working"
"""What a worker tells when it begins with a photo, and from then on at each step, now and then: who
is slow does not hang."""

_BREATH = 1.0
"""Seconds between two signs of life."""

_QUALITY = 88


@dataclass(frozen=True, eq=False)
class LocalizeJob:
    """A photo: the bytes of a file, what messages call it, its camera, and a prior. Without the
    name of a map, it is looked for in all."""

    map: str
    photo: bytes
    name: str
    camera: Camera | None
    prior: PosePrior | None


@dataclass(frozen=True, eq=False)
class RenderJob:
    """What a camera would see; answered by the bytes of a JPEG."""

    map: str
    camera: Camera
    cam_from_world: Float64Array


@dataclass(frozen=True)
class AboveJob:
    """The map from above; answered by JSON, see :func:`gscpe.report.map_from_above`."""

    map: str


Job = LocalizeJob | RenderJob | AboveJob


class Desk(Closing):
    """Holds localizers; see :class:`gscpe.batch.in_process.Works`."""

    def __init__(self, shelf: Shelf, description: str) -> None:
        self._shelf = shelf
        self._building: Building | None = None
        self.description = description

    @classmethod
    def start(cls, order: ShelfOrder, threads: int | None) -> Desk:
        """Opens the first map, so that what is wrong with all of them is known at once.

        Raises:
            GscpeError: as :meth:`gscpe.batch.shelf.Shelf.localizer`.
        """
        if threads is not None:
            cv2.setNumThreads(threads)
        shelf = Shelf(order)
        first = shelf.localizer(next(iter(order.folders)))
        return cls(shelf, first.renderer_description)

    def work(self, job: Job, talk: Talk) -> Any:
        """The answer, or a :class:`gscpe.service.problem.Problem`.

        Raises:
            RenderError: rendering failed; another process may do better.
            StoppedError: nobody waits for the answer any more, which is no failure.
        """
        try:
            return self._work(job, talk)
        except (EOFError, ConnectionError, RenderError, StoppedError):
            raise
        except Exception as error:
            if ran_out_of_memory(error):
                return too_large("there is not enough memory for this photo; shrink it")
            problem = problem_of(error)
            if problem.status == 500:
                _log.exception("map %s: %s failed", job.map, type(job).__name__)
            return problem

    def _work(self, job: Job, talk: Talk) -> Any:
        if isinstance(job, LocalizeJob):
            talk.tell(DECODING)
            photo = OnePhoto.decode(job.photo, job.name, job.camera)
            talk.tell(WORKING)
            talk.stop_if_told()
            if not job.map:
                return self._all_maps().localize(photo, _Watching(talk)).as_json()
            localizer = self._shelf.localizer(job.map)
            return localize_one(localizer, photo, job.prior, _Watching(talk)).as_json()
        localizer = self._shelf.localizer(job.map)
        if isinstance(job, RenderJob):
            return rendered(localizer, job.camera, job.cam_from_world)
        return map_from_above(localizer.map)

    def _all_maps(self) -> Building:
        """Made when it is first needed."""
        if self._building is None:
            self._building = Building(self._shelf)
        return self._building

    def close(self) -> None:
        self._shelf.close()


def rendered(localizer: Localizer, camera: Camera, cam_from_world: Float64Array) -> bytes | Problem:
    """A JPEG of what a camera, without its distortion, would see."""
    view = localizer.render(camera.without_distortion(), cam_from_world)
    bgr = to_uint8(view.rgb)[:, :, ::-1]
    encoded, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data.tobytes() if encoded else failed()


class _Watching(Observer):
    """At each step: ends the work soon after nobody waits for it any more, or gives a sign of
    life."""

    def __init__(self, talk: Talk) -> None:
        self._talk = talk
        self._told = time.monotonic()

    def _step(self) -> None:
        self._talk.stop_if_told()
        if time.monotonic() >= self._told + _BREATH:
            self._talk.tell(WORKING)
            self._told = time.monotonic()

    def round_done(
        self, view: RenderedView, matches: Matches, estimate: AbsolutePose | None
    ) -> None:
        self._step()

    def anchor_rendered(self, view: RenderedView) -> None:
        self._step()

    def mask_made(self, mask: BoolArray) -> None:
        self._step()

    def attempted(self, attempt: Attempt) -> None:
        self._step()
