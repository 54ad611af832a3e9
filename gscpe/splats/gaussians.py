# SPDX-License-Identifier: Apache-2.0
"""A 3D Gaussian splat as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Sequence

import numpy as np
from numpy.typing import ArrayLike

from gscpe.arrays import BoolArray, Float32Array, Float64Array, IntArray
from gscpe.errors import SplatError

LARGEST = 1e15
"""Of any value: squares of it, in pixels, still fit float32 where scenes are rendered."""

NEAR = 0.2
"""The near plane of 3DGS: Gaussians with a centre nearer than this are not drawn."""

_FAR = 100.0
"""Extents of a scene from zero, beyond which it gets an origin of its own."""

SH_C0 = 0.28209479177387814
"""The constant spherical harmonic; ``colour = 0.5 + SH_C0 * sh[:, 0]`` at degree 0."""


@dataclass(frozen=True, eq=False)
class GaussianScene:
    """Gaussians with their activations applied (Kerbl et al., 3D Gaussian Splatting, 2023).

    All arrays are float32, finite, and within 1e15 of zero; N > 0.

    Attributes:
        means: (N, 3) centres, relative to ``origin``.
        quaternions: (N, 4) unit quaternions (w, x, y, z), the Gaussian's axes in the
            world.
        scales: (N, 3) standard deviations along the axes, > 0.
        opacities: (N,) in [0, 1].
        sh: (N, K, 3) spherical harmonic coefficients of the colour, K = 1, 4, 9 or 16.
        antialiased: whether the splat was trained with the opacity compensation of
            Mip-Splatting (2024), so that rendering must apply it too.
        near: Gaussians whose centres are nearer to the camera than this are not drawn.
        origin: (3,) float64, the point of the world that the means are relative to; not 0 if the
            scene is so far from zero (UTM) that float32 is not precise enough.

    Raises:
        SplatError: a shape or a value is out of these bounds.
    """

    means: Float32Array
    quaternions: Float32Array
    scales: Float32Array
    opacities: Float32Array
    sh: Float32Array
    antialiased: bool = False
    near: float = NEAR
    origin: Float64Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {
            "means": (n, 3),
            "quaternions": (n, 4),
            "scales": (n, 3),
            "opacities": (n,),
        }
        for name, shape in shapes.items():
            self._check(name, getattr(self, name), shape)
        if self.sh.ndim != 3 or self.sh.shape[1] not in (1, 4, 9, 16):
            raise SplatError(f"sh must be (N, 1|4|9|16, 3), not {self.sh.shape}")
        self._check("sh", self.sh, (n, self.sh.shape[1], 3))
        if n == 0:
            raise SplatError("the splat is empty: it holds no Gaussians")
        if np.any(self.scales <= 0):
            raise SplatError("scales must be positive")
        if np.any((self.opacities < 0) | (self.opacities > 1)):
            raise SplatError("opacities must lie in [0, 1]")
        if not 0 < self.near < np.inf:
            raise SplatError(f"the near plane must be at a positive distance, not {self.near}")
        if self.origin.shape != (3,) or not np.all(np.isfinite(self.origin)):
            raise SplatError("the origin of a splat must be three finite numbers")

    @staticmethod
    def _check(name: str, array: Float32Array, shape: tuple[int, ...]) -> None:
        if array.shape != shape or array.dtype != np.float32:
            raise SplatError(
                f"{name} must be float32 of shape {shape}, not {array.dtype} {array.shape}"
            )
        finite = np.isfinite(array)
        if not np.all(finite):
            bad = int(len(array) - np.count_nonzero(finite.reshape(len(array), -1).all(axis=1)))
            raise SplatError(
                f"{bad} of {len(array)} Gaussians have NaN or infinite {name}; "
                "remove them or train the splat again"
            )
        largest = float(np.abs(array).max(initial=0.0))
        if largest > LARGEST:
            raise SplatError(
                f"{name} reach {largest:.3g}, which no scene needs (damaged?); values up to "
                f"{LARGEST:.0e} can be rendered"
            )

    def __len__(self) -> int:
        return len(self.means)

    def taken(self, rows: IntArray | BoolArray) -> GaussianScene:
        """Those of these rows: indices, (M,), or a mask, (N,); SplatError where none are left."""
        return replace(
            self,
            means=self.means[rows],
            quaternions=self.quaternions[rows],
            scales=self.scales[rows],
            opacities=self.opacities[rows],
            sh=self.sh[rows],
        )

    def __repr__(self) -> str:
        antialiased = ", antialiased" if self.antialiased else ""
        low, high = (np.array2string(f(self.means, axis=0), precision=3) for f in (np.min, np.max))
        return (
            f"GaussianScene({len(self)} Gaussians, harmonics of degree {self.sh_degree}"
            f"{antialiased}, from {low} to {high})"
        )

    @property
    def sh_degree(self) -> int:
        """0, 1, 2 or 3."""
        return int(np.sqrt(self.sh.shape[1])) - 1


def joined(scenes: Sequence[GaussianScene]) -> GaussianScene:
    """All of their Gaussians, relative to the origin of the first; harmonics that some do not
    have are zero."""
    first = scenes[0]
    most = max(scene.sh.shape[1] for scene in scenes)
    sh = [np.pad(s.sh, ((0, 0), (0, most - s.sh.shape[1]), (0, 0))) for s in scenes]
    means = [(s.means + (s.origin - first.origin)).astype(np.float32) for s in scenes]
    return replace(
        first,
        means=np.concatenate(means),
        quaternions=np.concatenate([scene.quaternions for scene in scenes]),
        scales=np.concatenate([scene.scales for scene in scenes]),
        opacities=np.concatenate([scene.opacities for scene in scenes]),
        sh=np.concatenate(sh),
    )


def far_origin(point: Float64Array, extent: float) -> Float64Array:
    """An origin, (3,), for coordinates around a point, (3,), that extend so far: zero where they
    are near zero anyway; else the point, where float32 would lose what matters."""
    return np.round(point) if np.linalg.norm(point) > _FAR * extent else np.zeros(3)


def normalized_quaternions(quaternions: ArrayLike) -> Float32Array:
    """Unit quaternions, (N, 4) float32; a zero quaternion means no rotation, as in 3DGS."""
    quaternions = np.array(quaternions, dtype=np.float64)  # lengths may overflow float32
    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    quaternions[length[:, 0] < 1e-12] = (1.0, 0.0, 0.0, 0.0)
    with np.errstate(invalid="ignore"):  # GaussianScene reports what is infinite
        return np.asarray(quaternions / np.where(length < 1e-12, 1.0, length), dtype=np.float32)
