# SPDX-License-Identifier: Apache-2.0
"""The unit of a model from a length that its photos show: two points, each found in two photos."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import ReconstructionError
from gscpe.geometry.similarity_transform import Similarity
from gscpe.reconstruction.lengths import KnownLengths
from gscpe.reconstruction.scale import placed_name

_CLICK = 0.002  # standard deviation of a pixel found by hand, as a share of the longer side
_MOST_OFF = 5 * _CLICK
_MOST_SIGMA = 0.1  # of a length, relative
_MOST_CONTRADICTION = 0.1  # of two lengths, relative, beyond what clicks explain
_PARALLEL = 1e-5  # two rays, a quarter of a degree
_STEPS = 20


@dataclass(frozen=True)
class _Sight:
    """A point in a photo: ``direction`` is x/z and y/z in the camera; ``focal`` makes pixels of a
    difference of directions, ``size`` is the longer side, pixels."""

    photo: str
    cam_from_world: Float64Array
    direction: Float64Array
    focal: float
    size: int

    def off(self, point: Float64Array) -> Float64Array:
        """(2,), from where the point would be seen, as a share of the longer side."""
        x, y, z = self.cam_from_world[:3, :3] @ point + self.cam_from_world[:3, 3]
        return np.asarray((np.array([x, y]) / z - self.direction) * self.focal / self.size)

    def is_before(self, point: Float64Array) -> bool:
        return bool(self.cam_from_world[2, :3] @ point + self.cam_from_world[2, 3] > 0)

    def slope(self, point: Float64Array) -> Float64Array:
        """(2, 3), of :meth:`off` by the point."""
        rotation = self.cam_from_world[:3, :3]
        x, y, z = rotation @ point + self.cam_from_world[:3, 3]
        by_cam = np.array([[1 / z, 0, -x / z**2], [0, 1 / z, -y / z**2]])
        return np.asarray(by_cam @ rotation * self.focal / self.size)


def scaled_by_points(
    model: Any, lengths: KnownLengths, sizes: Mapping[str, tuple[int, int]]
) -> Similarity:
    """The scaling of a model to metres: points are triangulated from where photos show them
    (least squares of their images), and lengths weigh as much as pixels found by hand make them
    exact (standard deviation 0.2% of the photo's longer side).

    Args:
        model: pycolmap.Reconstruction.
        lengths: pixels, of photos as displayed.
        sizes: width and height of the photos that pixels refer to, by the photo's name, where they
            are not the model's.

    Raises:
        ReconstructionError: a photo was not placed; a pixel is outside of its photo; the photos do
            not show one point there, or stand too close together to tell where it is; lengths
            contradict each other.
    """
    poses = {str(image.name): image for image in model.images.values() if image.has_pose}
    found: dict[str, tuple[Float64Array, Float64Array]] = {}
    for name in sorted({name for pair in lengths.metres for name in pair}):
        sights = [
            _sight(name, poses[placed_name(photo, poses)], pixel, sizes)
            for photo, pixel in lengths.seen[name].items()
        ]
        found[name] = _triangulated(name, sights)
    ratios, sigmas, pairs = [], [], []
    for (a, b), metres in lengths.metres.items():
        step = found[a][0] - found[b][0]
        apart = float(np.linalg.norm(step))
        along = step / max(apart, 1e-12)
        sigma = float(np.sqrt(along @ (found[a][1] + found[b][1]) @ along)) / max(apart, 1e-12)
        if not sigma <= _MOST_SIGMA:
            raise ReconstructionError(
                f"the photos tell the distance of {a!r} and {b!r} to {sigma:.0%} only: show both "
                "points in photos that were taken farther apart, or in more of them"
            )
        ratios.append(metres / apart)
        sigmas.append(max(sigma, 1e-3))
        pairs.append(f"{a!r} to {b!r}")
    logs, weights = np.log(ratios), 1.0 / np.square(sigmas)
    mean = float(np.sum(weights * logs) / np.sum(weights))
    off = np.abs(logs - mean) - 2.0 * np.asarray(sigmas)
    worst = int(np.argmax(off))
    if off[worst] > _MOST_CONTRADICTION:
        raise ReconstructionError(
            f"the lengths contradict each other: by all of them, {pairs[worst]} is "
            f"{list(lengths.metres.values())[worst] * np.exp(mean - logs[worst]):.3g} m, not "
            f"{list(lengths.metres.values())[worst]:g} m"
        )
    return Similarity(float(np.exp(mean)), np.eye(3), np.zeros(3))


def check_pixel(point: str, photo: str, pixel: tuple[float, float], size: tuple[int, int]) -> None:
    """Raises ReconstructionError where a point is not within its photo, of this width and height
    as displayed; the centre of the top-left pixel is (0.5, 0.5)."""
    if not (0 <= pixel[0] <= size[0] and 0 <= pixel[1] <= size[1]):
        raise ReconstructionError(
            f"point {point!r} is at {pixel[0]:g}, {pixel[1]:g} in {photo}, outside of its "
            f"{size[0]}x{size[1]} pixels"
        )


def _sight(
    point: str, image: Any, pixel: tuple[float, float], sizes: Mapping[str, tuple[int, int]]
) -> _Sight:
    camera, photo = image.camera, str(image.name)
    width, height = sizes.get(photo, (camera.width, camera.height))
    check_pixel(point, photo, pixel, (width, height))
    scaled = np.array([pixel]) * (camera.width / width, camera.height / height)
    direction = camera.cam_from_img(scaled)
    if direction is None or not np.all(np.isfinite(direction)):
        raise ReconstructionError(f"{photo} cannot show {point!r} at {pixel[0]:g}, {pixel[1]:g}")
    pose = np.eye(4)
    pose[:3] = image.cam_from_world().matrix()
    return _Sight(
        photo,
        pose,
        np.asarray(direction, dtype=np.float64)[0],
        float(camera.mean_focal_length()),
        max(camera.width, camera.height),
    )


def _triangulated(name: str, sights: list[_Sight]) -> tuple[Float64Array, Float64Array]:
    """The point, (3,), and its covariance, (3, 3): Gauss-Newton from the point nearest to the
    rays."""
    normals, moments = np.zeros((3, 3)), np.zeros(3)
    for sight in sights:
        rotation, translation = sight.cam_from_world[:3, :3], sight.cam_from_world[:3, 3]
        ray = rotation.T @ np.append(sight.direction, 1.0)
        ray /= np.linalg.norm(ray)
        across = np.eye(3) - np.outer(ray, ray)
        normals += across
        moments -= across @ (rotation.T @ translation)
    if np.linalg.eigvalsh(normals)[0] < _PARALLEL:
        raise ReconstructionError(
            f"the photos that show {name!r} were taken from one spot, which does not tell how far "
            "it is: show it in photos that were taken farther apart"
        )
    point: Float64Array = np.asarray(np.linalg.solve(normals, moments))
    for _ in range(_STEPS):
        if not all(sight.is_before(point) for sight in sights):
            break
        slope = np.concatenate([sight.slope(point) for sight in sights])
        off = np.concatenate([sight.off(point) for sight in sights])
        step = np.linalg.lstsq(slope, -off, rcond=None)[0]
        point = np.asarray(point + step)
        if np.linalg.norm(step) < 1e-10 * np.linalg.norm(point):
            break
    behind = not all(sight.is_before(point) for sight in sights)
    offs = np.array([np.linalg.norm(sight.off(point)) for sight in sights])
    if behind or not np.all(offs <= _MOST_OFF):
        worst = sights[int(np.argmax(offs))]
        how = "" if behind else f" ({np.max(offs):.1%} of the photo's size off)"
        raise ReconstructionError(
            f"the photos do not show one point {name!r}: {worst.photo} does not fit{how}. Pixels "
            "are of the photos as displayed, at their full size"
        )
    slope = np.concatenate([sight.slope(point) for sight in sights])
    return point, _CLICK**2 * np.linalg.pinv(slope.T @ slope, rcond=1e-15)
