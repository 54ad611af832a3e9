# SPDX-License-Identifier: Apache-2.0
"""A world with a known answer that owes nothing to the splat renderer: ray-cast planes.

A room's corner (back wall, side wall, floor) with a slanted board in it. Every pixel's ray
is intersected with the planes in float64, so depth is exact; colours are smooth textures,
sampled with cubic splines at the pixel centre. World axes: x right, y down, z forward.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Mapping, Sequence

import numpy as np
from helpers import distorted_projection
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter, spline_filter
from scipy.spatial.transform import Rotation

from gscpe.geometry import Camera, se3
from gscpe.geometry.projection import pixel_centres
from gscpe.mapping import map_from_rgbd
from gscpe.poses.hloc import format_pose
from gscpe.render import RenderedView
from gscpe.scene import Map
from gscpe.splats import GaussianScene
from gscpe.splats.gaussians import SH_C0, joined

_TEXELS = 256


@dataclass(frozen=True, eq=False)
class Plane:
    """A textured plane: an origin, two unit axes, a half size along each, and (3, T, T) spline
    coefficients of a periodic texture whose texels are ``texel`` wide."""

    origin: NDArray[np.float64]
    axes: NDArray[np.float64]
    half_size: tuple[float, float]
    texture: NDArray[np.float32]
    texel: float = 0.01

    def scaled(self, factor: float) -> Plane:
        """The plane where all lengths are ``factor`` times as long."""
        a, b = self.half_size
        return replace(
            self,
            origin=self.origin * factor,
            half_size=(a * factor, b * factor),
            texel=self.texel * factor,
        )


@dataclass(frozen=True, eq=False)
class Shot:
    """A ray-cast photo: (H, W, 3) float64 in [0, 1], exact z-depth (H, W) float32."""

    rgb: NDArray[np.float64]
    depth: NDArray[np.float32]

    @property
    def uint8(self) -> NDArray[np.uint8]:
        """The photo as a camera stores it."""
        return np.asarray(np.rint(np.clip(self.rgb, 0.0, 1.0) * 255.0), dtype=np.uint8)


def _texture(seed: int, sigmas: Sequence[float], base: Sequence[float]) -> NDArray[np.float32]:
    """Smoothed noise and a few sinusoids, in about [0.1, 0.9]; (3, T, T) spline coefficients."""
    rng = np.random.default_rng(seed)

    def smooth_noise() -> NDArray[np.float64]:
        layers = (gaussian_filter(rng.normal(size=shape), s, mode="wrap") for s in sigmas)
        image = sum((layer / layer.std() for layer in layers), np.zeros(shape))
        for _ in range(2):
            frequencies = rng.integers(1, 5, 2)
            image += 0.5 * np.outer(*(np.sin(f * waves + rng.uniform(0, 6)) for f in frequencies))
        return np.asarray(image / image.std())

    shape, waves = (_TEXELS, _TEXELS), 2.0 * np.pi * np.arange(_TEXELS) / _TEXELS
    grey = smooth_noise()
    channels = [mean + 0.35 * np.tanh(0.6 * grey + 0.2 * smooth_noise()) for mean in base]
    return np.stack(
        [spline_filter(c, order=3, mode="grid-wrap", output=np.float32) for c in channels]
    )


@dataclass(frozen=True, eq=False)
class World:
    """Planes; the nearest one ahead is seen, and black where there is none."""

    planes: tuple[Plane, ...]

    def scaled(self, factor: float) -> World:
        """The world where all lengths are ``factor`` times as long."""
        return World(tuple(plane.scaled(factor) for plane in self.planes))

    def shoot(self, camera: Camera, cam_from_world: NDArray[np.float64], samples: int = 1) -> Shot:
        """What a camera, distorted or not, takes from a pose.

        With ``samples`` x ``samples`` colours a pixel, edges are smooth as in a photo; depth
        is that of the pixel centre.
        """
        if samples > 1:
            height, width = camera.height, camera.width
            fine = self.shoot(camera.resized(samples * width, samples * height), cam_from_world)
            blocks = fine.rgb.reshape(height, samples, width, samples, 3)
            return Shot(blocks.mean(axis=(1, 3)), self.shoot(camera, cam_from_world).depth)
        rays = camera_rays(camera) @ cam_from_world[:3, :3]  # z-depth 1 in the camera
        centre = -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]
        depth = np.full(len(rays), np.inf)
        rgb = np.zeros((len(rays), 3))
        for plane in self.planes:
            normal = np.cross(*plane.axes)
            slope = rays @ normal
            z = (plane.origin - centre) @ normal / np.where(np.abs(slope) < 1e-12, 1e-12, slope)
            a, b = ((centre + rays * z[:, None] - plane.origin) @ plane.axes.T).T
            within = (np.abs(a) <= plane.half_size[0]) & (np.abs(b) <= plane.half_size[1])
            hit = np.flatnonzero(within & (z > 1e-6) & (z < depth))
            at = np.stack([b[hit], a[hit]]) / plane.texel
            depth[hit] = z[hit]
            for channel, texture in enumerate(plane.texture):
                rgb[hit, channel] = map_coordinates(
                    texture, at, order=3, mode="grid-wrap", prefilter=False
                )
        size = (camera.height, camera.width)
        seen = np.where(np.isfinite(depth), depth, 0.0)
        return Shot(rgb.reshape(*size, 3), seen.reshape(size).astype(np.float32))


def camera_rays(camera: Camera) -> NDArray[np.float64]:
    """Rays, (H * W, 3), of z = 1 through the pixel centres; distortion is inverted."""
    pixels = pixel_centres(camera).reshape(-1, 2)
    focal, principal = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    rays = np.ones((len(pixels), 3))
    rays[:, :2] = (pixels - principal) / focal
    for _ in range(0 if camera.is_pinhole else 50):
        rays[:, :2] -= (distorted_projection(camera, rays) - pixels) / focal
    return rays


@functools.cache
def room(seed: int = 0, smoothness: float = 1.0) -> World:
    """A corner about 2.5 m away, with a slanted board in front; the seed paints it, and the
    smoothness widens the texture's features (2.2 cm and up)."""
    x, y, z = np.eye(3)
    turned = se3.exp([0, 0, 0, 0.35, 0.5, 0.2])[:3, :3]
    fine = tuple(smoothness * sigma for sigma in (2.2, 4.5, 9.0))
    coarse = tuple(1.5 * sigma for sigma in fine)
    return World(
        (
            Plane(2.4 * z, np.stack([x, y]), (np.inf, np.inf), _texture(seed, fine, (0.5,) * 3)),
            Plane(1.2 * x, np.stack([z, y]), (np.inf, np.inf),
                  _texture(seed + 1000, coarse, (0.45, 0.5, 0.6))),
            Plane(0.8 * y, np.stack([x, z]), (np.inf, np.inf),
                  _texture(seed + 2000, coarse, (0.6, 0.5, 0.45))),
            Plane(np.array([0.3, 0.1, 1.9]), (turned @ np.stack([x, y]).T).T, (0.4, 0.35),
                  _texture(seed + 3000, fine, (0.5, 0.6, 0.5))),
        )
    )  # fmt: skip


@functools.cache
def wall(distance: float = 2.0, seed: int = 5) -> World:
    """A single fronto-parallel wall (seen from the identity pose)."""
    axes = np.eye(3)[:2]
    texture = _texture(seed, (2.2, 4.5, 9.0), (0.5, 0.5, 0.5))
    return World((Plane(np.array([0, 0, distance]), axes, (np.inf, np.inf), texture),))


def room_camera(width: int = 160, height: int = 120) -> Camera:
    """About 60 degrees wide, off-centre, fx != fy."""
    return Camera.pinhole(
        width, height, fx=0.87 * width, fy=0.88 * width, cx=0.48 * width, cy=0.52 * height
    )


ROOM_POSE = se3.exp([0.05, -0.1, 0.1, 0.05, -0.12, 0.03])
"""Where the room's reference photo is taken: near the origin, turned about all axes."""


@functools.cache
def room_shot(width: int = 240, height: int = 180) -> Shot:
    """The reference photo of the room."""
    return room().shoot(room_camera(width, height), ROOM_POSE)


@functools.cache
def room_map(scale: float = 1.0, metres_per_unit: float | None = 1.0) -> Map:
    """A map of the reference photo and its depth, all lengths times ``scale``."""
    shot, pose = room_shot(), scaled_pose(ROOM_POSE, scale)
    return map_from_rgbd(
        shot.uint8,
        np.asarray(scale * shot.depth, dtype=np.float32),
        room_camera(240, 180),
        pose,
        "room.png",
        metres_per_unit=metres_per_unit,
    )


def scaled_pose(cam_from_world: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
    """The pose in the world where all lengths are ``factor`` times as long."""
    pose = np.array(cam_from_world, dtype=np.float64)
    pose[:3, 3] *= factor
    return pose


@dataclass
class RayCastRenderer:
    """Stands in for gscpe.render.Renderer: an exact picture and exact depth of a world."""

    world: World
    samples: int = 1
    renders: int = 0

    def render(self, camera: Camera, cam_from_world: NDArray[np.float64]) -> RenderedView:
        self.renders += 1
        shot = self.world.shoot(camera, cam_from_world, self.samples)
        return RenderedView(
            rgb=shot.rgb.astype(np.float32),
            opacity=(shot.depth > 0).astype(np.float32),
            depth=shot.depth,
            depth_variance=np.zeros_like(shot.depth),
            camera=camera,
            cam_from_world=np.array(cam_from_world),
        )


def away_from_creases(shot: Shot, margin: int = 1) -> NDArray[np.bool_]:
    """Pixels, (H, W), whose neighbours all lie on the same plane, where inverse depth is linear.

    Other pixels show two textures that meet in a step, which no interpolation can follow.
    """
    inverse_depth = 1.0 / np.where(shot.depth > 0, shot.depth, np.inf).astype(np.float64)
    bend = sum(np.abs(np.gradient(np.gradient(inverse_depth, axis=i), axis=i)) for i in (0, 1))
    return np.asarray(maximum_filter(bend, size=2 * margin + 1) < 1e-4)


def write_colmap_model(
    folder: Path, camera: Camera, poses: Mapping[str, NDArray[np.float64]]
) -> None:
    """A COLMAP text model without points: one camera, and photos by name."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text(f"# cameras\n1 {camera.colmap_text()}\n")
    lines = ["# images"]
    for number, (name, pose) in enumerate(poses.items(), start=1):
        lines += [f"{number} {format_pose(pose)} 1 {name}", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "points3D.txt").write_text("# points\n")


def furnished_room() -> World:
    """A closed room, 4 m by 3.4 m and 2.4 m high, with a table and a cupboard; z is up, and the
    floor is at 0. No texture is that of another face."""
    x, y, z = np.eye(3)

    def face(number: int, centre: Sequence[float], a: float, b: float, *axes: object) -> Plane:
        texture = _texture(100 + number, (2.2, 4.5, 9.0), (0.5, 0.5, 0.5))
        return Plane(np.array(centre), np.array(axes, dtype=np.float64), (a, b), texture)

    return World(
        (
            face(0, (0, 0, 0), 2.0, 1.7, x, y),
            face(1, (0, 0, 2.4), 2.0, 1.7, x, y),
            face(2, (-2, 0, 1.2), 1.7, 1.2, y, z),
            face(3, (2, 0, 1.2), 1.7, 1.2, y, z),
            face(4, (0, -1.7, 1.2), 2.0, 1.2, x, z),
            face(5, (0, 1.7, 1.2), 2.0, 1.2, x, z),
            face(6, (1.3, 1.0, 0.7), 0.6, 0.5, x, y),
            face(7, (1.3, 0.5, 0.35), 0.6, 0.35, x, z),
            face(8, (-1.4, -1.2, 1.0), 0.4, 0.5, x, y),
            face(9, (-1.4, -0.7, 0.5), 0.4, 0.5, x, z),
            face(10, (-1.0, -1.2, 0.5), 0.5, 0.5, y, z),
        )
    )


def splat_of(world: World, step: float = 0.04) -> GaussianScene:
    """Flat Gaussians on all planes of a world, which must be bounded, so far apart."""
    parts = []
    for plane in world.planes:
        rows = [np.arange(-half + step / 2, half, step) for half in plane.half_size]
        a, b = (grid.ravel() for grid in np.meshgrid(*rows, indexing="ij"))
        at = np.stack([b, a]) / plane.texel
        rgb = [
            map_coordinates(channel, at, order=3, mode="grid-wrap", prefilter=False)
            for channel in plane.texture
        ]
        axes = np.stack([*plane.axes, np.cross(*plane.axes)], axis=1)
        quaternion = Rotation.from_matrix(axes).as_quat(scalar_first=True)
        parts.append(
            GaussianScene(
                means=(plane.origin + np.stack([a, b], 1) @ plane.axes).astype(np.float32),
                quaternions=np.tile(quaternion, (len(a), 1)).astype(np.float32),
                scales=np.tile([0.5 * step, 0.5 * step, 0.03 * step], (len(a), 1)).astype(
                    np.float32
                ),
                opacities=np.full(len(a), 0.95, dtype=np.float32),
                sh=((np.stack(rgb, axis=1) - 0.5) / SH_C0).astype(np.float32)[:, None],
            )
        )
    return joined(parts)
