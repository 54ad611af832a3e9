# SPDX-License-Identifier: Apache-2.0
"""Views that hardly determine the pose: no answer, or one whose covariance admits the error.

Maps of one ray-cast RGB-D photo; queries 5 cm and 1.5 degrees beside it, with noise. Whatever
renders and whatever samples poses: noise that one of them happens to have must not decide.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import Plane, World, room, room_camera, wall

from gscpe import LocalizationResult, Localizer, LocalizerSettings, PosePrior
from gscpe.coarse import CoarseSettings, PnPSettings
from gscpe.coarse.ransac import Solver
from gscpe.evaluation import normalized_error_squared
from gscpe.geometry import pose_difference, se3
from gscpe.mapping import map_from_rgbd
from gscpe.scene import Map

CAMERA = room_camera(240, 180)
NOISE = 2.0 / 255.0
MAPPED = 1000
"""Seed of the map's photo: no other has the same noise."""


def faded(world: World, contrast: float) -> World:
    """The world in pale colours."""

    def fade(plane: Plane) -> Plane:
        mean = plane.texture.mean(axis=(1, 2), keepdims=True)
        return replace(plane, texture=mean + np.float32(contrast) * (plane.texture - mean))

    return World(tuple(fade(plane) for plane in world.planes))


def striped(world: World, turned: bool = False, faint: float = 0.0) -> World:
    """The first plane in vertical stripes: nothing tells how high the camera is. Or turned, in
    horizontal ones; or with a faint texture of this standard deviation, which does tell."""
    plane = world.planes[0]
    texture = plane.texture
    stripes = np.broadcast_to(texture.mean(axis=1, keepdims=True), texture.shape)
    stripes = np.float32(0.5) + 4 * (stripes - np.float32(0.5))
    if turned:
        stripes = stripes.swapaxes(1, 2)
    stripes = stripes + np.float32(faint / texture.std()) * (texture - texture.mean())
    return World((replace(plane, texture=np.ascontiguousarray(stripes)),))


WORLDS: dict[str, Callable[[], World]] = {
    "blank wall": functools.partial(faded, wall(), 0.0),
    "pale wall": functools.partial(faded, wall(), 0.03),
    "striped wall": functools.partial(striped, wall()),
    "horizontal stripes": functools.partial(striped, wall(), turned=True),
    "faint texture": functools.partial(striped, wall(), faint=0.006),
    "one plane": wall,
    "pale room": functools.partial(faded, room(), 0.05),
}


@functools.cache
def map_of(name: str) -> Map:
    shot = WORLDS[name]().shoot(CAMERA, np.eye(4))
    return map_from_rgbd(with_noise(shot.rgb, MAPPED), shot.depth, CAMERA, np.eye(4))


def localizer_of(name: str, backend: str, solver: Solver) -> Localizer:
    if solver == "pycolmap":
        pytest.importorskip("pycolmap")
    settings = LocalizerSettings(coarse=CoarseSettings(pnp=PnPSettings(solver=solver)))
    return Localizer(map_of(name), settings, backend=backend)


@functools.cache
def photo_of(name: str, seed: int) -> NDArray[np.uint8]:
    """As it was taken from ``pose(seed)``."""
    return with_noise(WORLDS[name]().shoot(CAMERA, pose(seed)).rgb, seed)


def with_noise(rgb: NDArray[np.float64], seed: int, times: float = 1.0) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    noisy = rgb + times * NOISE * rng.normal(size=rgb.shape)
    return np.asarray(np.rint(255 * np.clip(noisy, 0, 1)), dtype=np.uint8)


def pose(seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(100 + seed)
    return se3.exp(rng.normal(size=6) * [0.03, 0.03, 0.03, 0.015, 0.015, 0.015])


def admits_its_error(result: LocalizationResult, truth: NDArray[np.float64]) -> bool:
    """Not localized; or within a tenth of a pixel; or six numbers are within 6 standard
    deviations of the truth, all together."""
    if result.cam_from_world is None or result.covariance is None:
        return not result.localized and result.reason is not None
    error = pose_difference(result.cam_from_world, truth)
    if error.distance < 1e-3 and error.degrees < 0.03:
        return True
    return normalized_error_squared(result.cam_from_world, result.covariance, truth) < 6.0**2


@pytest.mark.parametrize(("backend", "solver"), [("cpu", "pycolmap"), ("gl", "opencv")])
@pytest.mark.parametrize("name", WORLDS)
def test_never_confident_and_wrong(name: str, backend: str, solver: Solver) -> None:
    with localizer_of(name, backend, solver) as localizer:
        for seed in range(4):
            result = localizer.localize(photo_of(name, seed), CAMERA)
            assert admits_its_error(result, pose(seed))


@pytest.mark.parametrize("solver", ["pycolmap", "opencv"])
@pytest.mark.parametrize("name", ["blank wall", "striped wall", "horizontal stripes"])
def test_nothing_to_tell_where(name: str, backend: str, solver: Solver) -> None:
    with localizer_of(name, backend, solver) as localizer:
        for seed in (1, 2):
            result = localizer.localize(photo_of(name, seed), CAMERA)
            assert not result.localized
            assert result.reason


@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_no_noise_is_a_texture(noise: float) -> None:
    """Along the stripes, matches agree with each other on a place, but none can tell whether it
    is the right one; nor does a prior that says so make it known."""
    world = striped(wall())
    shot = world.shoot(CAMERA, np.eye(4))
    map_ = map_from_rgbd(with_noise(shot.rgb, MAPPED, noise), shot.depth, CAMERA, np.eye(4))
    with Localizer(map_) as localizer:
        for seed in range(2):
            photo = with_noise(world.shoot(CAMERA, pose(seed)).rgb, seed, noise)
            prior = PosePrior(pose(seed), 0.1, 5.0)
            assert not localizer.localize(photo, CAMERA, prior).localized


def test_one_plane_is_enough() -> None:
    with Localizer(map_of("one plane")) as localizer:
        for seed in range(4):
            photo = with_noise(wall().shoot(CAMERA, pose(seed)).rgb, seed)
            result = localizer.localize(photo, CAMERA)
            assert result.cam_from_world is not None, result.reason
            error = pose_difference(result.cam_from_world, pose(seed))
            assert error.distance < 2e-3  # a fifth of a pixel
            assert error.degrees < 0.05


@pytest.mark.parametrize("side", ["left", "top"])
def test_half_of_the_photo_covered(side: str) -> None:
    shot = room().shoot(CAMERA, np.eye(4))
    rows, columns = {"left": (slice(None), slice(120)), "top": (slice(90), slice(None))}[side]
    with Localizer(map_from_rgbd(shot.uint8, shot.depth, CAMERA, np.eye(4))) as localizer:
        for seed in range(3):
            photo = with_noise(room().shoot(CAMERA, pose(seed)).rgb, seed)
            whole = localizer.localize(photo, CAMERA)
            photo[rows, columns] = (70, 60, 50)
            half = localizer.localize(photo, CAMERA)
            assert admits_its_error(half, pose(seed))
            if half.aligned is not None and half.aligned.covariance is not None:
                assert whole.aligned is not None
                assert whole.aligned.covariance is not None
                more, less = half.aligned.covariance[:3, :3], whole.aligned.covariance[:3, :3]
                assert np.trace(more) > np.trace(less)
