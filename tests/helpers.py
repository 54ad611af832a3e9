# SPDX-License-Identifier: Apache-2.0
"""Scenes, poses, cameras and files that several tests make."""

from __future__ import annotations

from pathlib import Path
from typing import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gscpe.errors import MapError
from gscpe.geometry import Camera
from gscpe.scene import GlobalDescriptors, Map, References, open_map
from gscpe.splats import GaussianScene


def random_rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """A (3, 3) rotation, uniform over all rotations."""
    quaternion = rng.normal(size=4)
    return np.asarray(Rotation.from_quat(quaternion / np.linalg.norm(quaternion)).as_matrix())


def random_pose(rng: np.random.Generator) -> NDArray[np.float64]:
    """A (4, 4) world-to-camera pose with any rotation."""
    pose = np.eye(4)
    pose[:3, :3] = random_rotation(rng)
    pose[:3, 3] = rng.uniform(-2.0, 2.0, 3)
    return pose


def random_scene(
    rng: np.random.Generator,
    count: int,
    sh_degree: int,
    *,
    cam_from_world: NDArray[np.float64] | None = None,
    scale: tuple[float, float] = (0.05, 0.3),
    opacity: tuple[float, float] = (0.05, 0.95),
    antialiased: bool = False,
) -> GaussianScene:
    """Gaussians 1.5 to 5 units in front of a camera (at the origin unless given).

    Colours stay in about [-0.2, 1.2] before the clamp at 0; centres spill over the borders
    of a 60 degree field of view.
    """
    depth = rng.uniform(1.5, 5.0, count)
    in_cam = np.stack([*(rng.uniform(-0.7, 0.7, (2, count)) * depth), depth], axis=1)
    pose = np.eye(4) if cam_from_world is None else cam_from_world
    quaternions = rng.normal(size=(count, 4))
    coefficients = (sh_degree + 1) ** 2
    sh = rng.normal(0.0, 0.3 / np.sqrt(coefficients), (count, coefficients, 3))
    sh[:, 0] = rng.uniform(-2.2, 2.4, (count, 3))
    return GaussianScene(
        means=((in_cam - pose[:3, 3]) @ pose[:3, :3]).astype(np.float32),
        quaternions=(quaternions / np.linalg.norm(quaternions, axis=1)[:, None]).astype(np.float32),
        scales=np.exp(rng.uniform(np.log(scale[0]), np.log(scale[1]), (count, 3))).astype(
            np.float32
        ),
        opacities=rng.uniform(*opacity, count).astype(np.float32),
        sh=sh.astype(np.float32),
        antialiased=antialiased,
    )


def simple_camera(width: int = 64, height: int = 48, focal: float | None = None) -> Camera:
    """A centred pinhole camera, by default with a 60 degree horizontal field of view."""
    f = 0.866 * width if focal is None else focal
    return Camera.pinhole(width, height, fx=f, fy=f, cx=width / 2, cy=height / 2)


def splat_columns(sh_degree: int) -> list[str]:
    """The properties of a 3DGS ``.ply``, in the order of the original exporter."""
    rest = 3 * ((sh_degree + 1) ** 2 - 1)
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(rest)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def splat_table(scene: GaussianScene) -> NDArray[np.float32]:
    """The rows of a 3DGS ``.ply``: log scales, logit opacities, colour-major ``f_rest``."""
    count = len(scene)
    opacities = scene.opacities.astype(np.float64)
    table = np.concatenate(
        [
            scene.means,
            np.zeros((count, 3)),
            scene.sh[:, 0],
            scene.sh[:, 1:].transpose(0, 2, 1).reshape(count, -1),
            np.log(opacities / (1.0 - opacities))[:, None],
            np.log(scene.scales),
            scene.quaternions,
        ],
        axis=1,
    )
    return table.astype(np.float32)


def splat_header(
    columns: Sequence[str], count: int, *, encoding: str, comments: Sequence[str] = ()
) -> str:
    """The header text of a PLY file with float vertices."""
    lines = [
        "ply",
        f"format {encoding} 1.0",
        *(f"comment {comment}" for comment in comments),
        f"element vertex {count}",
        *(f"property float {name}" for name in columns),
        "end_header",
    ]
    return "\n".join(lines) + "\n"


def write_table(
    path: Path,
    columns: Sequence[str],
    table: NDArray[np.float32],
    *,
    comments: Sequence[str] = (),
    encoding: str = "binary_little_endian",
) -> None:
    """Writes a PLY file of float columns."""
    header = splat_header(columns, len(table), encoding=encoding, comments=comments)
    if encoding == "ascii":
        body = "".join(" ".join(f"{x:.9g}" for x in row) + "\n" for row in table).encode()
    else:
        body = table.astype("<f4" if "little" in encoding else ">f4").tobytes()
    path.write_bytes(header.encode() + body)


def write_splat(
    path: Path,
    scene: GaussianScene,
    *,
    comments: Sequence[str] = (),
    encoding: str = "binary_little_endian",
) -> None:
    """Writes a scene as a 3DGS ``.ply``."""
    columns = splat_columns(scene.sh_degree)
    write_table(path, columns, splat_table(scene), comments=comments, encoding=encoding)


def distorted_projection(camera: Camera, points_in_cam: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels, (N, 2), COLMAP's convention: FULL_OPENCV, or the fisheye with thin prisms, written
    out from its definition."""
    if camera.fisheye:
        return _fisheye_projection(camera, points_in_cam)
    k1, k2, p1, p2, k3, k4, k5, k6 = camera.distortion or (0.0,) * 8
    x, y = (points_in_cam[:, :2] / points_in_cam[:, 2:]).T
    r2 = x * x + y * y
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
    return np.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], axis=1)


def _fisheye_projection(camera: Camera, points_in_cam: NDArray[np.float64]) -> NDArray[np.float64]:
    k1, k2, p1, p2, k3, k4, s1, s2 = camera.distortion or (0.0,) * 8
    across = np.linalg.norm(points_in_cam[:, :2], axis=1)
    angle = np.arctan2(across, points_in_cam[:, 2])
    x, y = (points_in_cam[:, :2] / np.maximum(across, 1e-300)[:, None] * angle[:, None]).T
    radial = 1 + k1 * angle**2 + k2 * angle**4 + k3 * angle**6 + k4 * angle**8
    u = x * radial + 2 * p1 * x * y + p2 * (angle**2 + 2 * x * x) + s1 * angle**2
    v = y * radial + 2 * p2 * x * y + p1 * (angle**2 + 2 * y * y) + s2 * angle**2
    return np.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], axis=1)


def numeric_jacobian(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    at: NDArray[np.float64],
    step: float = 1e-6,
) -> NDArray[np.float64]:
    """Central differences of a vector function, (M, N), at a vector (N,)."""
    columns = [
        (function(at + step * e) - function(at - step * e)) / (2 * step) for e in np.eye(len(at))
    ]
    return np.stack(columns, axis=-1)


def some_map(rng: np.random.Generator, *, count: int = 30, references: int = 5) -> Map:
    """A map with all kinds of cameras; what it shows means nothing."""
    cameras = [
        Camera.pinhole(640, 480, fx=500 / 3, fy=510.1, cx=1 / 7, cy=239.0),
        Camera.parse("OPENCV,640,480,500.1,510.2,321.3,239.4,0.1,-0.05,0.002,-0.003"),
        Camera.parse("SIMPLE_RADIAL,1920,1080,1500.5,960,540,-0.123456789"),
    ]
    descriptors = rng.normal(size=(references, 64)).astype(np.float32)
    return Map(
        scene=random_scene(rng, count, 2, antialiased=True),
        references=References(
            names=tuple(f"room {i}/büro-{i}.jpg" for i in range(references)),
            cam_from_world=np.stack([random_pose(rng) for _ in range(references)]),
            cameras=tuple(cameras[i % 3] for i in range(references)),
        ),
        descriptors=GlobalDescriptors(rng.normal(size=(4, 128)).astype(np.float32), descriptors),
    )


def assert_same_map(a: Map, b: Map) -> None:
    """Fails unless two maps are equal to the last bit."""
    for name in ("means", "quaternions", "scales", "opacities", "sh"):
        array = getattr(a.scene, name)
        np.testing.assert_array_equal(array, getattr(b.scene, name))
        assert array.dtype == np.float32
    assert a.scene.antialiased is b.scene.antialiased
    assert a.metres_per_unit == b.metres_per_unit
    assert a.frame.scale == b.frame.scale
    np.testing.assert_array_equal(a.frame.origin, b.frame.origin)
    assert a.scene.near == b.scene.near
    assert a.references.names == b.references.names
    assert a.references.cameras == b.references.cameras
    np.testing.assert_array_equal(a.references.cam_from_world, b.references.cam_from_world)
    np.testing.assert_array_equal(a.descriptors.vocabulary, b.descriptors.vocabulary)
    np.testing.assert_array_equal(a.descriptors.descriptors, b.descriptors.descriptors)


def check_one_wrong_byte(
    path: Path, count: int, assert_same: Callable[[Map], None], seed: int = 3
) -> None:
    """Changes bytes of a file of a map's folder, one at a time: that is noticed, or, in
    ``map.json``, it makes no difference."""
    data = path.read_bytes()
    rng = np.random.default_rng(seed)
    for offset in rng.integers(0, len(data), count):
        damaged = bytearray(data)
        damaged[offset] ^= rng.integers(1, 256)
        path.write_bytes(damaged)
        try:
            opened = open_map(path.parent)
        except MapError as error:
            assert str(path.parent) in str(error)
        else:
            assert path.name == "map.json", f"byte {offset} of {path.name} went unnoticed"
            assert_same(opened)
