# SPDX-License-Identifier: Apache-2.0
"""How well matches agree with poses, whatever the points are: their distance from the epipolar
lines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

import numpy as np

from gscpe.arrays import Float64Array


@dataclass(frozen=True, eq=False)
class MatchedPairs:
    """Matches between photos that two views alone agree on.

    Attributes:
        names: P pairs of photos.
        rays: of each pair, two arrays (M, 2): the matches' directions in both cameras, x/z and y/z.
        focal: of each pair, pixels: what turns a distance of directions into one of pixels.
    """

    names: tuple[tuple[str, str], ...]
    rays: tuple[tuple[Float64Array, Float64Array], ...]
    focal: tuple[float, ...]

    def errors(self, poses: Mapping[str, Float64Array]) -> list[Float64Array]:
        """Of each pair whose photos both have a pose, the Sampson distances of its matches, (M,)
        pixels; of the others, (0,).

        Hartley and Zisserman, Multiple View Geometry, 2nd ed., (11.9).

        Args:
            poses: ``cam_from_world``, (4, 4), by name.
        """
        found = []
        for (a, b), (rays_a, rays_b), focal in zip(self.names, self.rays, self.focal, strict=True):
            if a in poses and b in poses:
                found.append(focal * sampson_distances(poses[a], poses[b], rays_a, rays_b))
            else:
                found.append(np.zeros(0))
        return found


def sampson_distances(
    a_from_world: Float64Array,
    b_from_world: Float64Array,
    rays_a: Float64Array,
    rays_b: Float64Array,
) -> Float64Array:
    """First-order distance of matches, (M, 2) directions each, from where two poses, (4, 4), allow
    them to be; (M,), in units of the directions. Cameras in one place allow what a turn explains;
    then the distance from that is given."""
    b_from_a = b_from_world @ np.linalg.inv(a_from_world)
    a, b = (np.column_stack([rays, np.ones(len(rays))]) for rays in (rays_a, rays_b))
    turned = a @ b_from_a[:3, :3].T
    step = b_from_a[:3, 3]
    if np.linalg.norm(step) < 1e-9:
        return np.asarray(np.linalg.norm(turned[:, :2] / turned[:, 2:] - b[:, :2], axis=1))
    x, y, z = step
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ b_from_a[:3, :3]
    line_b, line_a = a @ essential.T, b @ essential
    slope = np.sum(line_b[:, :2] ** 2, axis=1) + np.sum(line_a[:, :2] ** 2, axis=1)
    return np.asarray(np.abs(np.sum(b * line_b, axis=1)) / np.sqrt(np.maximum(slope, 1e-30)))


def read_matched_pairs(database: Path) -> MatchedPairs:
    """Of a COLMAP database, whose cameras are known."""
    import pycolmap

    names, rays, focal = [], [], []
    with pycolmap.Database.open(database) as stored:
        cameras = {camera.camera_id: camera for camera in stored.read_all_cameras()}
        directions: dict[int, Float64Array] = {}
        image_of: dict[int, Any] = {}
        for image in stored.read_all_images():
            pixels = stored.read_keypoints(image.image_id)[:, :2].astype(np.float64)
            directions[image.image_id] = np.asarray(
                cameras[image.camera_id].cam_from_img(pixels), dtype=np.float64
            )
            image_of[image.image_id] = image
        numbers, geometries = stored.read_two_view_geometries()
        for number, geometry in zip(numbers, geometries, strict=True):
            if not len(geometry.inlier_matches):
                continue
            a, b = pycolmap.pair_id_to_image_pair(number)
            names.append((str(image_of[a].name), str(image_of[b].name)))
            of_a, of_b = geometry.inlier_matches.T.astype(np.int64)
            rays.append((directions[a][of_a], directions[b][of_b]))
            lengths = [cameras[image_of[i].camera_id].mean_focal_length() for i in (a, b)]
            focal.append(float(np.mean(lengths)))
    return MatchedPairs(tuple(names), tuple(rays), tuple(focal))
