# SPDX-License-Identifier: Apache-2.0
"""The backward pass against central differences, for every parameter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Callable, Sequence

import numpy as np
import pytest
from helpers import random_pose, random_scene, simple_camera
from numpy.typing import NDArray

from gscpe.geometry import Camera, se3
from gscpe.render import Renderer
from gscpe.render.kernel_threads import KernelThreads
from gscpe.splats import GaussianScene

pytest.importorskip("numba")

from frozen_splatting import Parameters, splat

from gscpe.training import backward_projection as layout
from gscpe.training.harmonics import fill_basis
from gscpe.training.rasterizer import DepthGradient, Gradients, TrainingRasterizer

NAMES = ("means", "log_scales", "quaternions", "logits", "sh")
CAMERA = Camera.pinhole(44, 35, fx=40.0, fy=37.0, cx=20.5, cy=18.0)


Floats = NDArray[np.float32]


def arrays(scene: GaussianScene) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    return scene.means, scene.quaternions, scene.scales, scene.opacities, scene.sh


def hard_scene(
    rng: np.random.Generator, sh_degree: int, pose: NDArray[np.float64], antialiased: bool
) -> GaussianScene:
    """Among others a Gaussian that is opaque, one far beside the image, and one that is black in
    some channels."""
    scene = random_scene(
        rng, 9, sh_degree, cam_from_world=pose, antialiased=antialiased, opacity=(0.2, 0.9)
    )
    scene.opacities[0] = 0.9998
    scene.scales[0] = 1.2
    beside = np.array([1.7, 0.1, 2.0]) - pose[:3, 3]
    scene.means[1] = (beside @ pose[:3, :3]).astype(np.float32)
    scene.scales[1] = (0.5, 0.4, 0.45)
    scene.sh[2, 0] = (-2.9, 1.0, -2.8)
    return scene


def analytic(
    scene: GaussianScene,
    pose: NDArray[np.float64],
    weights: NDArray[np.float32],
    opacity_weights: NDArray[np.float32],
    depth_gradient: DepthGradient | None = None,
    threads: int = 1,
) -> tuple[dict[str, NDArray[np.float64]], Gradients]:
    """Gradients of a weighted sum of the pixels, by name."""
    rasterizer = TrainingRasterizer(KernelThreads(threads), scene.antialiased)
    forward = rasterizer.forward(arrays(scene), CAMERA, pose)
    gradients = rasterizer.backward(
        arrays(scene), forward, weights, opacity_weights, depth_gradient
    )
    found = {
        "means": np.zeros((len(scene), 3)),
        "log_scales": np.zeros((len(scene), 3)),
        "quaternions": np.zeros((len(scene), 4)),
        "logits": np.zeros(len(scene)),
        "sh": np.zeros(scene.sh.shape),
    }
    basis = np.zeros(16, dtype=np.float32)
    for begin, end in gradients.used:
        for slot in range(begin, end):
            g = int(gradients.keys[slot] & np.uint64(0xFFFFFFFF))
            row = gradients.by_slot[slot]
            found["means"][g] = row[layout.POSITION : layout.POSITION + 3]
            found["log_scales"][g] = row[layout.LOG_SCALE : layout.LOG_SCALE + 3]
            found["quaternions"][g] = row[layout.QUATERNION : layout.QUATERNION + 4]
            found["logits"][g] = row[layout.LOGIT]
            fill_basis(basis, scene.sh.shape[1], *row[layout.DIRECTION : layout.DIRECTION + 3])
            colour = row[layout.COLOUR : layout.COLOUR + 3]
            found["sh"][g] = np.outer(basis[: scene.sh.shape[1]], colour)
    return found, gradients


@pytest.fixture
def weights(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    shape = (CAMERA.height, CAMERA.width)
    return (
        rng.normal(size=(*shape, 3)).astype(np.float32),
        rng.normal(size=shape).astype(np.float32),
    )


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
@pytest.mark.parametrize("antialiased", [False, True])
def test_every_parameter_against_central_differences(
    sh_degree: int,
    antialiased: bool,
    rng: np.random.Generator,
    weights: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> None:
    pose = random_pose(rng)
    scene = hard_scene(rng, sh_degree, pose, antialiased)
    found, gradients = analytic(scene, pose, *weights)
    base = Parameters.of(scene, pose)
    rgb, opacity, _, decisions = splat(base, CAMERA, antialiased)
    for clamp in (decisions.full, decisions.black, decisions.beside):
        assert any(np.any(one) for one in clamp)  # or nothing would be proved about it
    view = TrainingRasterizer(KernelThreads(1), antialiased).forward(arrays(scene), CAMERA, pose)
    np.testing.assert_allclose(view.view.rgb, rgb, atol=2e-5)  # the same picture to begin with
    np.testing.assert_allclose(view.view.opacity, opacity, atol=2e-5)

    def loss(parameters: Parameters) -> float:
        rgb, opacity, _, _ = splat(parameters, CAMERA, antialiased, decisions)
        return float(np.sum(weights[0] * rgb) + np.sum(weights[1] * opacity))

    assert_derivatives(loss, base, found, gradients)


def assert_derivatives(
    loss: Callable[[Parameters], float],
    base: Parameters,
    found: dict[str, NDArray[np.float64]],
    gradients: Gradients,
    names: Sequence[str] = NAMES,
) -> None:
    """All of them, and those of the pose, against central differences."""
    for name in names:
        numeric = np.zeros_like(found[name])
        for index in np.ndindex(numeric.shape):
            up, down = (base.nudged(name, index, step) for step in (1e-5, -1e-5))
            numeric[index] = (loss(up) - loss(down)) / 2e-5
        scale = np.abs(numeric).max()
        assert scale > 1e-2, name
        np.testing.assert_allclose(found[name], numeric, atol=2e-4 * scale, err_msg=name)

    numeric_pose = np.zeros(6)
    for k, step in enumerate(1e-5 * np.eye(6)):
        ends = [
            loss(replace(base, cam_from_world=se3.exp(sign * step) @ base.cam_from_world))
            for sign in (1, -1)
        ]
        numeric_pose[k] = (ends[0] - ends[1]) / 2e-5
    np.testing.assert_allclose(gradients.pose, numeric_pose, atol=2e-4 * np.abs(numeric_pose).max())


def depth_weights(opacity: NDArray[Any], rng: np.random.Generator) -> DepthGradient:
    """At some pixels that have a depth; at one of them twice."""
    rows, columns = np.nonzero(opacity > 0.3)
    chosen = rng.permutation(len(rows))[:30]
    chosen[1] = chosen[0]
    return DepthGradient(
        rows[chosen], columns[chosen], rng.normal(size=len(chosen)).astype(np.float32)
    )


@pytest.mark.parametrize("with_colours", [False, True])
@pytest.mark.parametrize("antialiased", [False, True])
def test_depth_against_central_differences(
    antialiased: bool,
    with_colours: bool,
    rng: np.random.Generator,
    weights: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> None:
    """Alone, and added to what the colours say."""
    pose = random_pose(rng)
    scene = hard_scene(rng, 1, pose, antialiased)
    base = Parameters.of(scene, pose)
    _, opacity, depth, decisions = splat(base, CAMERA, antialiased)
    at = depth_weights(opacity, rng)
    colours = np.float32(0.02 * with_colours)
    found, gradients = analytic(scene, pose, colours * weights[0], colours * weights[1], at)
    view = TrainingRasterizer(KernelThreads(1), antialiased).forward(arrays(scene), CAMERA, pose)
    np.testing.assert_allclose(view.view.depth[opacity > 0.3], depth[opacity > 0.3], rtol=2e-5)

    def loss(parameters: Parameters) -> float:
        rgb, opacity, depth, _ = splat(parameters, CAMERA, antialiased, decisions)
        total = np.sum(at.values * depth[at.rows, at.columns])
        total += np.sum(colours * weights[0] * rgb) + np.sum(colours * weights[1] * opacity)
        return float(total)

    names = NAMES if with_colours else NAMES[:-1]
    assert_derivatives(loss, base, found, gradients, names)
    assert with_colours or not np.any(found["sh"])


def test_behind_opaque_gaussians_too(
    rng: np.random.Generator, weights: tuple[NDArray[np.float32], NDArray[np.float32]]
) -> None:
    """Where rows and tiles end early, hidden Gaussians have no gradient, and the visible ones
    the right one, to what a transmittance of 1e-4 can hide."""
    scene = random_scene(rng, 400, 1, opacity=(0.7, 0.98), scale=(0.2, 0.5))
    found, _ = analytic(scene, np.eye(4), *weights)
    base = Parameters.of(scene, np.eye(4))
    decisions = splat(base, CAMERA, False)[3]

    def loss(parameters: Parameters) -> float:
        rgb, opacity, _, _ = splat(parameters, CAMERA, False, decisions)
        return float(np.sum(weights[0] * rgb) + np.sum(weights[1] * opacity))

    nearest, last = decisions.order[:4], decisions.order[-1]
    for g in nearest:
        for axis in range(3):
            up, down = (base.nudged("means", (g, axis), step) for step in (1e-5, -1e-5))
            numeric = (loss(up) - loss(down)) / 2e-5
            assert abs(found["means"][g, axis] - numeric) < 1e-3 * np.abs(found["means"]).max()
    assert not np.any(found["means"][last])


def test_forward_has_the_bits_of_the_renderer(rng: np.random.Generator) -> None:
    pose, camera = random_pose(rng), simple_camera(70, 50)
    scene = random_scene(rng, 3000, 3, cam_from_world=pose, scale=(0.01, 0.2))
    twins = np.tile(scene.means[:5], (2, 1))  # equal depths: the order must be the same too
    scene = GaussianScene(
        np.concatenate([scene.means[:-10], twins]),
        scene.quaternions, scene.scales, scene.opacities, scene.sh,
    )  # fmt: skip
    ours = TrainingRasterizer(KernelThreads(2)).forward(arrays(scene), camera, pose).view
    with Renderer(scene, "cpu") as renderer:
        theirs = renderer.render(camera, pose)
    for name in ("rgb", "opacity", "depth", "depth_variance"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_the_number_of_threads_changes_no_bit(
    rng: np.random.Generator, weights: tuple[NDArray[np.float32], NDArray[np.float32]]
) -> None:
    scene = random_scene(rng, 9000, 2, scale=(0.01, 0.1))
    forward = TrainingRasterizer(KernelThreads(1)).forward(arrays(scene), CAMERA, np.eye(4))
    at = depth_weights(forward.view.opacity, rng)
    alone, alone_gradients = analytic(scene, np.eye(4), *weights, at, threads=1)
    many, many_gradients = analytic(scene, np.eye(4), *weights, at, threads=3)
    for name in NAMES:
        np.testing.assert_array_equal(alone[name], many[name])
    np.testing.assert_array_equal(alone_gradients.pose, many_gradients.pose)
