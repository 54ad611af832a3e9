# SPDX-License-Identifier: Apache-2.0
"""The frame that a map works in: near its origin, and in metres.

Whoever built the map has a frame of their own, the world: its origin may be thousands of
kilometres away (UTM), and its unit may be anything. Inside the map, float32 must do, and lengths
that were chosen for rooms must fit. So everything inside lives in the map's own frame,

    x_map = scale * (x_world - origin),

whose unit is a metre where the world's unit is known, and else such that the typical surface is
seen from 2 m. Whoever crosses from one to the other, foremost gscpe.localization for photos and
gscpe.mapping for maps, does so through :class:`MapFrame`: nothing else multiplies by a unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import MapError
from gscpe.geometry.projection import transform_points
from gscpe.scene.references import References
from gscpe.splats.gaussians import NEAR, GaussianScene

TYPICAL_DEPTH = 2.0
"""Metres from which surfaces in rooms are seen; lengths in settings are made for it."""

_VIEWS = 12
_NEAREST = 0.2
"""The near plane lies at most at this share of the typical depth."""


@dataclass(frozen=True, eq=False)
class MapFrame:
    """Where the map's frame lies in the world.

    Attributes:
        origin: (3,) float64, of the map in the world, world units.
        scale: map units per world unit, > 0.
        metres_per_unit: length of a world unit in metres; None where it is not known.

    Raises:
        MapError: a value is out of these bounds.
    """

    origin: Float64Array = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0
    metres_per_unit: float | None = 1.0

    def __post_init__(self) -> None:
        if self.metres_per_unit is not None and not 0 < self.metres_per_unit < np.inf:
            raise MapError(f"metres per unit must be positive, not {self.metres_per_unit}")
        if not 0 < self.scale < np.inf:
            raise MapError(f"the scale of a map must be positive, not {self.scale}")
        if self.origin.shape != (3,) or not np.all(np.isfinite(self.origin)):
            raise MapError("the origin of a map must be three finite numbers")

    @classmethod
    def around(
        cls, scene: GaussianScene, references: References, metres_per_unit: float | None
    ) -> MapFrame:
        """The frame for a splat and its references, both in the world."""
        if metres_per_unit is not None:
            return cls(scene.origin, metres_per_unit, metres_per_unit)
        return cls(scene.origin, TYPICAL_DEPTH / typical_depth(scene, references), None)

    def cam_from_map(self, cam_from_world: Float64Array) -> Float64Array:
        """A pose, (4, 4) or (N, 4, 4), with respect to the map; its translation in map units."""
        moved = np.array(cam_from_world, dtype=np.float64)
        moved[..., :3, 3] = self.scale * (moved[..., :3, 3] + moved[..., :3, :3] @ self.origin)
        return moved

    def cam_from_world(self, cam_from_map: Float64Array) -> Float64Array:
        """The inverse of :meth:`cam_from_map`: a pose, (4, 4) or (N, 4, 4), with respect to the
        world; its translation in world units."""
        moved = np.array(cam_from_map, dtype=np.float64)
        moved[..., :3, 3] = moved[..., :3, 3] / self.scale - moved[..., :3, :3] @ self.origin
        return moved

    def world_covariance(self, covariance: Float64Array) -> Float64Array:
        """(6, 6) of xi in ``exp(xi) @ pose``, in world units, from map units."""
        units = np.repeat([1.0 / self.scale, 1.0], 3)
        return np.asarray(covariance * np.outer(units, units))

    def length_text(self, length: float) -> str:
        """A length in map units, for people: in metres, or in world units where these are not
        known."""
        if self.metres_per_unit is not None:
            return f"{length:.3g} m"
        return f"{length / self.scale:.3g} units"

    def scene_in_map(self, scene: GaussianScene, depth: float) -> GaussianScene:
        """The splat with respect to the map.

        Its near plane is that of 3DGS, or nearer where the surfaces are: a fifth of their
        typical depth.

        Args:
            scene: in the world.
            depth: typical depth of surfaces before a camera, world units.
        """
        near = near_plane(depth * self.scale)
        shift = self.scale * (scene.origin - self.origin)
        if self.scale == 1.0 and not np.any(shift):
            return replace(scene, origin=np.zeros(3), near=near)
        with np.errstate(over="ignore", under="ignore"):  # GaussianScene reports what is infinite
            return replace(
                scene,
                means=(self.scale * scene.means.astype(np.float64) + shift).astype(np.float32),
                scales=(self.scale * scene.scales.astype(np.float64)).astype(np.float32),
                origin=np.zeros(3),
                near=near,
            )

    def references_in_map(self, references: References) -> References:
        """The references with respect to the map."""
        return replace(references, cam_from_world=self.cam_from_map(references.cam_from_world))


def near_plane(depth: float) -> float:
    """Distance below which Gaussians are not drawn, where surfaces are typically so far away:
    that of 3DGS, or a fifth of the depth where this is less."""
    return min(NEAR, _NEAREST * depth)


def typical_depth(scene: GaussianScene, references: References) -> float:
    """Median depth of the Gaussians that the references see, in the world's units; where there
    are no references, or they see nothing, how far the Gaussians are spread.

    Gaussians hide each other, so that this is more than the depth of what is seen; it is meant
    for tolerances, not for measuring.
    """
    depths = []
    step = max(1, len(scene) // 50_000)
    solid = np.flatnonzero(scene.opacities[::step] >= 0.5) * step
    means = scene.means[solid if len(solid) else slice(None, None, step)].astype(np.float64)
    # Not evenly_spread, which rounds: a map that is built again would get another scale.
    count = len(references)
    chosen = np.unique(np.linspace(0, max(count - 1, 0), _VIEWS).astype(int))[: min(count, _VIEWS)]
    for index in chosen:
        camera = references.cameras[index]
        cam_from_scene = references.cam_from_world[index].copy()
        cam_from_scene[:3, 3] += cam_from_scene[:3, :3] @ scene.origin
        x, y, z = transform_points(cam_from_scene, means).T
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        seen = (z > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        if np.count_nonzero(seen) >= 10:
            depths.append(float(np.median(z[seen])))
    if depths:
        return float(np.median(depths))
    spread = np.linalg.norm(means - np.median(means, axis=0), axis=1)
    return max(float(np.median(spread)), float(np.median(scene.scales)))
