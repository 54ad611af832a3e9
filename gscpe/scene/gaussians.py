"""A 3D Gaussian splat as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gscpe.arrays import Float32Array
from gscpe.errors import SplatError

_LARGEST = 1e15  # squares of it, in pixels, still fit float32 where scenes are rendered

SH_C0 = 0.28209479177387814
"""The constant spherical harmonic; ``colour = 0.5 + SH_C0 * sh[:, 0]`` at degree 0."""


@dataclass(frozen=True, eq=False)
class GaussianScene:
    """Gaussians with their activations applied (Kerbl et al., 3D Gaussian Splatting, 2023).

    All arrays are float32, finite, and within 1e15 of zero; N > 0.

    Attributes:
        means: (N, 3) centres in the world, map units.
        quaternions: (N, 4) unit quaternions (w, x, y, z), the Gaussian's axes in the world.
        scales: (N, 3) standard deviations along the axes, map units, > 0.
        opacities: (N,) in [0, 1].
        sh: (N, K, 3) spherical harmonic coefficients of the colour, K = 1, 4, 9 or 16.
        antialiased: whether the splat was trained with the opacity compensation of
            Mip-Splatting (2024), so that rendering must apply it too.

    Raises:
        SplatError: a shape or a value is out of these bounds.
    """

    means: Float32Array
    quaternions: Float32Array
    scales: Float32Array
    opacities: Float32Array
    sh: Float32Array
    antialiased: bool = False

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
        if largest > _LARGEST:
            raise SplatError(
                f"{name} reach {largest:.3g}, which no scene needs (damaged?); values up to "
                f"{_LARGEST:.0e} can be rendered"
            )

    def __len__(self) -> int:
        return len(self.means)

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


def normalized_quaternions(quaternions: ArrayLike) -> Float32Array:
    """Unit quaternions, (N, 4) float32; a zero quaternion means no rotation, as in 3DGS."""
    quaternions = np.array(quaternions, dtype=np.float64)  # lengths may overflow float32
    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    quaternions[length[:, 0] < 1e-12] = (1.0, 0.0, 0.0, 0.0)
    with np.errstate(invalid="ignore"):  # GaussianScene reports what is infinite
        return np.asarray(quaternions / np.where(length < 1e-12, 1.0, length), dtype=np.float32)
