# SPDX-License-Identifier: Apache-2.0
"""The Gaussians while they are trained."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from gscpe.arrays import Float32Array, IntArray
from gscpe.render.spatial_chunks import morton_order
from gscpe.splats.gaussians import SH_C0, GaussianScene

MOMENTS = 14
"""Values of a Gaussian that Adam keeps moments of: position, logarithms of scales, quaternion,
logit of the opacity, colour of degree 0."""


@dataclass(frozen=True, eq=False)
class Parameters:
    """N Gaussians; the arrays are changed in place. All are float32 but ``steps``.

    Attributes:
        means: (N, 3).
        log_scales, scales: (N, 3); each changes with the other, as do
        logits, opacities: (N,).
        quaternions: (N, 4) of unit length.
        sh: (N, K, 3), K of the degree that is trained at the moment.
        first, second: (N, MOMENTS) moments of Adam.
        steps: (N,) int32, how often each was updated.
    """

    means: Float32Array
    log_scales: Float32Array
    scales: Float32Array
    quaternions: Float32Array
    logits: Float32Array
    opacities: Float32Array
    sh: Float32Array
    first: Float32Array
    second: Float32Array
    steps: np.ndarray[tuple[int, ...], np.dtype[np.int32]]

    @classmethod
    def new(
        cls,
        means: Float32Array,
        log_scales: Float32Array,
        quaternions: Float32Array,
        logits: Float32Array,
        sh: Float32Array,
    ) -> Parameters:
        """Gaussians that were not updated yet."""
        count = len(means)
        return cls(
            means=means,
            log_scales=log_scales,
            scales=np.exp(log_scales),
            quaternions=quaternions,
            logits=logits,
            opacities=sigmoid(logits),
            sh=sh,
            first=np.zeros((count, MOMENTS), dtype=np.float32),
            second=np.zeros((count, MOMENTS), dtype=np.float32),
            steps=np.zeros(count, dtype=np.int32),
        )

    def __len__(self) -> int:
        return len(self.means)

    def as_rendered(
        self,
    ) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array, Float32Array]:
        """Means, quaternions, scales, opacities and sh, not copied."""
        return self.means, self.quaternions, self.scales, self.opacities, self.sh

    def take(self, indices: IntArray) -> Parameters:
        """Those Gaussians, copied."""
        return Parameters(
            **{f.name: np.ascontiguousarray(getattr(self, f.name)[indices]) for f in fields(self)}
        )

    def joined(self, other: Parameters) -> Parameters:
        """These Gaussians, and the others behind them."""
        return Parameters(
            **{
                f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)])
                for f in fields(self)
            }
        )

    def in_spatial_order(self) -> Parameters:
        """Neighbours next to each other: what a tile needs then lies together in memory."""
        return self.take(morton_order(self.means))

    def with_degree(self, degree: int) -> Parameters:
        """Colours of that degree; new coefficients are 0."""
        sh = np.zeros((len(self), (degree + 1) ** 2, 3), dtype=np.float32)
        kept = min(sh.shape[1], self.sh.shape[1])
        sh[:, :kept] = self.sh[:, :kept]
        return replace(self, sh=sh)

    def recolour(self, gain: Float32Array, bias: Float32Array) -> None:
        """Every colour becomes ``gain * colour + bias``, each (3,)."""
        self.sh[:] *= gain
        self.sh[:, 0] += (0.5 * gain + bias - 0.5) / np.float32(SH_C0)

    def scene(self, degree: int, antialiased: bool) -> GaussianScene:
        """A copy as a splat of that degree.

        Raises:
            SplatError: the training has diverged.
        """
        full = self.with_degree(degree)
        return GaussianScene(
            full.means.copy(),
            full.quaternions.copy(),
            full.scales.copy(),
            full.opacities.copy(),
            full.sh,
            antialiased,
        )


def sigmoid(logits: Float32Array) -> Float32Array:
    """1 / (1 + exp(-x)), in float32."""
    return np.asarray(1.0 / (1.0 + np.exp(-logits)), dtype=np.float32)
