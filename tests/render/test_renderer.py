# SPDX-License-Identifier: Apache-2.0
"""The renderer's pictures against the reference compositor, and its pixel convention."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import random_pose, random_scene, simple_camera
from numpy.typing import NDArray
from numpy_compositor import MIN_ALPHA, Composite, composite

from gscpe.geometry import Camera
from gscpe.geometry.projection import project
from gscpe.geometry.se3 import inverse
from gscpe.render import RenderedView, Renderer
from gscpe.splats import GaussianScene

CAMERAS = {
    "centred": simple_camera(64, 48),
    "odd size": simple_camera(61, 47),
    "off-centre, fx != fy": Camera.pinhole(61, 47, fx=58.0, fy=41.0, cx=17.3, cy=33.9),
    "principal point outside": Camera.pinhole(64, 48, fx=60.0, fy=60.0, cx=-20.5, cy=70.0),
    "tall and wide-angled": Camera.pinhole(32, 90, fx=15.0, fy=30.0, cx=16.0, cy=45.0),
    "long lens": Camera.pinhole(50, 50, fx=400.0, fy=380.0, cx=25.0, cy=25.0),
}


@dataclass(frozen=True)
class Worst:
    """The largest differences between a render and the reference.

    Depth and its variance: where opacity is over 0.5, and of all but one pixel in a thousand.
    A driver's rounding may put the rim of a Gaussian, where alpha is 1/255, on either side of
    the threshold; that pixel's depth then moves by up to 1% of the depth range.
    """

    rgb: float
    opacity: float
    relative_depth: float
    variance: float


def differences(view: RenderedView, reference: Composite) -> Worst:
    solid = reference.opacity > 0.5
    depth = np.where(solid, np.abs(view.depth - reference.depth) / (reference.depth + 1e-9), 0.0)
    variance = np.where(solid, np.abs(view.depth_variance - reference.depth_variance), 0.0)
    return Worst(
        rgb=float(np.abs(view.rgb - reference.rgb).max()),
        opacity=float(np.abs(view.opacity - reference.opacity).max()),
        relative_depth=float(np.quantile(depth, 0.999)),
        variance=float(np.quantile(variance, 0.999)),
    )


def check(
    scene: GaussianScene,
    camera: Camera,
    cam_from_world: NDArray[np.float64],
    backend: str,
    *,
    min_transmittance: float = 1e-4,
) -> Composite:
    """Renders both ways, fails on a visible difference, and returns the reference."""
    with Renderer(scene, backend) as renderer:
        view = renderer.render(camera, cam_from_world)
    reference = composite(scene, camera, cam_from_world, min_transmittance=min_transmittance)
    worst = differences(view, reference)
    assert reference.opacity.max() > MIN_ALPHA  # there is something to compare
    assert worst.rgb <= 1 / 255
    assert worst.opacity <= 1 / 255
    assert worst.relative_depth <= 1e-3
    assert worst.variance <= 1e-3
    # One pixel may fall on the other side of the 1/255 threshold, a whole picture may not.
    assert np.abs(view.rgb - reference.rgb).mean() <= 1e-5
    return reference


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics_and_filters(
    degree: int, antialiased: bool, rng: np.random.Generator, backend: str
) -> None:
    pose = random_pose(rng)
    scene = random_scene(rng, 150, degree, cam_from_world=pose, antialiased=antialiased)
    reference = check(scene, CAMERAS["off-centre, fx != fy"], pose, backend)
    assert (reference.opacity > 0.5).mean() > 0.2


@pytest.mark.parametrize("name", CAMERAS)
def test_cameras(name: str, rng: np.random.Generator, backend: str) -> None:
    pose = random_pose(rng)
    scene = random_scene(rng, 200, 1, cam_from_world=pose)
    check(scene, CAMERAS[name], pose, backend)


def test_an_image_of_one_pixel(rng: np.random.Generator, backend: str) -> None:
    check(
        random_scene(rng, 10, 1),
        Camera.pinhole(1, 1, fx=1.0, fy=1.0, cx=0.5, cy=0.5),
        np.eye(4),
        backend,
    )


def test_harmonics_alone_make_a_difference(rng: np.random.Generator) -> None:
    """The comparison would notice one harmonic with a wrong sign or place."""
    pose = random_pose(rng)
    scene = random_scene(rng, 150, 3, cam_from_world=pose)
    plain = composite(scene, CAMERAS["centred"], pose)
    for k in range(16):
        sh = scene.sh.copy()
        sh[:, k] *= -1
        other = composite(replace(scene, sh=sh), CAMERAS["centred"], pose)
        assert np.abs(other.rgb - plain.rgb).max() > 3 / 255


@pytest.mark.parametrize("antialiased", [False, True])
def test_needles_and_discs(antialiased: bool, rng: np.random.Generator, backend: str) -> None:
    pose = random_pose(rng)
    scene = random_scene(rng, 200, 0, cam_from_world=pose, antialiased=antialiased)
    scales = scene.scales.copy()
    scales[:100, :2] = 1e-4  # needles
    scales[:100, 2] = 0.4
    scales[100:, 0] = 1e-7  # discs
    check(replace(scene, scales=scales), CAMERAS["odd size"], pose, backend)


def test_points_far_below_a_pixel(rng: np.random.Generator, backend: str) -> None:
    pose = random_pose(rng)
    tiny = random_scene(rng, 300, 0, cam_from_world=pose, scale=(1e-5, 0.02))
    check(tiny, CAMERAS["centred"], pose, backend)
    check(replace(tiny, antialiased=True), CAMERAS["centred"], pose, backend)


def test_gaussians_larger_than_the_image(rng: np.random.Generator, backend: str) -> None:
    pose = random_pose(rng)
    scene = random_scene(rng, 40, 1, cam_from_world=pose, scale=(0.5, 4.0), opacity=(0.05, 0.4))
    check(scene, CAMERAS["odd size"], pose, backend)


def test_gaussians_near_and_behind_the_camera(rng: np.random.Generator, backend: str) -> None:
    """Centres from 1 behind to 1 before the camera: those up to 0.2 are not drawn."""
    scene = random_scene(rng, 120, 1, opacity=(0.05, 0.6))
    means = rng.uniform(-1.0, 1.0, (120, 3)).astype(np.float32)
    near = np.abs(means[:, 2] - 0.2) < 1e-3
    means[near, 2] = 0.3
    check(replace(scene, means=means), CAMERAS["off-centre, fx != fy"], np.eye(4), backend)


def test_faint_gaussians(rng: np.random.Generator, backend: str) -> None:
    """Opacities around 1/255, including exactly that in single precision."""
    scene = random_scene(rng, 200, 0)
    opacities = rng.uniform(0.0, 2.0 / 255.0, 200).astype(np.float32)
    opacities[:3] = 0.0, 1.0 / 255.0, np.nextafter(np.float32(1 / 255), np.float32(0))
    check(replace(scene, opacities=opacities), CAMERAS["centred"], np.eye(4), backend)


def test_opaque_gaussians(rng: np.random.Generator, backend: str) -> None:
    """Opacity 1 is clamped to 0.99. Blending composites to the very end, where 3DGS stops at
    a transmittance of 1e-4 and so loses up to 0.01: compared without that stop."""
    scene = random_scene(rng, 150, 0, opacity=(0.9, 1.0))
    opacities = scene.opacities.copy()
    opacities[::2] = 1.0
    scene = replace(scene, opacities=opacities)
    camera = CAMERAS["centred"]
    check(scene, camera, np.eye(4), backend, min_transmittance=0.0)
    with Renderer(scene, backend) as renderer:
        view = renderer.render(camera, np.eye(4))
    stopped = composite(scene, camera, np.eye(4))
    assert differences(view, stopped).opacity <= 0.01


@pytest.mark.parametrize("count", [1, 1023, 1024, 1025, 3000])
def test_counts_around_the_rows_of_the_textures(
    count: int, rng: np.random.Generator, backend: str
) -> None:
    scene = random_scene(rng, count, 1, scale=(0.01, 0.04), opacity=(0.05, 0.5))
    check(scene, simple_camera(40, 30), np.eye(4), backend)


def test_a_view_says_where_it_was_taken(rng: np.random.Generator, backend: str) -> None:
    pose = random_pose(rng)
    with Renderer(random_scene(rng, 20, 1, cam_from_world=pose), backend) as renderer:
        view = renderer.render(CAMERAS["odd size"], pose)
    assert view.camera == CAMERAS["odd size"]
    np.testing.assert_array_equal(view.cam_from_world, pose)
    assert view.cam_from_world is not pose
    for array in (view.rgb, view.opacity, view.depth, view.depth_variance):
        assert array.dtype == np.float32
        assert array.shape[:2] == (47, 61)
        assert array.flags.c_contiguous
        assert array.flags.writeable


@pytest.mark.parametrize("pixel", [(20.5, 15.5), (20.0, 15.0), (31.27, 22.81), (9.9, 40.4)])
@pytest.mark.parametrize("antialiased", [False, True])
def test_a_gaussian_appears_where_it_projects(
    pixel: tuple[float, float], antialiased: bool, rng: np.random.Generator, backend: str
) -> None:
    """The centre of the top-left pixel is (0.5, 0.5), to a hundredth of a pixel."""
    camera = Camera.pinhole(61, 47, fx=300.0, fy=280.0, cx=17.3, cy=33.9)
    pose = random_pose(rng)
    depth = 3.0
    in_cam = np.array([(pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy, 1.0])
    in_world = (inverse(pose) @ [*(in_cam * depth), 1.0])[:3]
    scene = GaussianScene(
        means=in_world[None].astype(np.float32),
        quaternions=np.array([[1, 0, 0, 0]], np.float32),
        scales=np.full((1, 3), 0.012, np.float32),
        opacities=np.array([0.9], np.float32),
        sh=np.full((1, 4, 3), 0.1, np.float32),
        antialiased=antialiased,
    )
    np.testing.assert_allclose(project(camera, in_cam[None])[0], pixel, atol=1e-9)
    with Renderer(scene, backend) as renderer:
        view = renderer.render(camera, pose)
    rows, columns = np.mgrid[0:47, 0:61]
    mass = view.opacity.astype(np.float64)
    centroid = [np.sum(mass * (columns + 0.5)), np.sum(mass * (rows + 0.5))] / mass.sum()
    np.testing.assert_allclose(centroid, pixel, atol=0.01)
    seen = view.opacity > 0
    np.testing.assert_allclose(view.depth[seen], depth, rtol=1e-5)
    np.testing.assert_allclose(view.depth_variance, 0.0, atol=1e-4)
