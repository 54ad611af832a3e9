# SPDX-License-Identifier: Apache-2.0
"""What the refinement finds."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.arrays import Float64Array, short_repr


@dataclass(frozen=True, eq=False)
class RefinementResult:
    """The aligned pose and how well it explains the photo.

    Attributes:
        cam_from_world: (4, 4); None when the alignment failed. Its world and unit are those of the
            splat that was rendered; in a :class:`gscpe.LocalizationResult`, the user's.
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``, (translation, rotation), in the
            same unit and radians.
        by_camera: (6, 5) derivative of the same xi with respect to the five numbers of the photo's
            camera, see ``Camera.covariance``.
        gain, bias: photo = gain * render + bias, luminance in [0, 1], where it is not clipped.
        residual: robust standard deviation of the photometric residual, luminance.
        agreement: mean local correlation of photo and render, in [-1, 1]; see
            ``RefinementSettings.agreement_level``.
        overlap: share of the image where both show the map, in [0, 1].
        pixels: number of pixels used at full size.
        anchors: renders that served as templates.
        tolerance_unit: tolerances, which are made for rooms, are divided by it: 1 where the median
            depth is between half a metre and 2 m; see :meth:`gscpe.RenderedView.tolerance_unit`.
        converged: whether the last level converged.
        reason: why it failed, or None.
        unshared: (6, 6), the part of the covariance due to directions in which photo and render
            share hardly any gradients (see :class:`gscpe.refinement.PoseUncertainty`); it holds for
            matches between the two as well. None if the alignment failed.
    """

    cam_from_world: Float64Array | None
    covariance: Float64Array | None
    gain: float
    bias: float
    residual: float
    agreement: float
    overlap: float
    pixels: int
    anchors: int
    tolerance_unit: float
    converged: bool
    reason: str | None = None
    by_camera: Float64Array | None = None
    unshared: Float64Array | None = None

    def __repr__(self) -> str:
        return short_repr(self)
