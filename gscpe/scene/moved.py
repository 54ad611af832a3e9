# SPDX-License-Identifier: Apache-2.0
"""A splat and references under a similarity: turned, scaled and shifted into another frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.geometry.similarity_transform import Similarity
from gscpe.scene.references import References
from gscpe.splats.gaussians import GaussianScene, far_origin
from gscpe.splats.turned import turned


def move_references(references: References, b_from_a: Similarity) -> References:
    """References with respect to a, with respect to b."""
    return replace(references, cam_from_world=b_from_a.cam_from_b(references.cam_from_world))


def move_scene(scene: GaussianScene, b_from_a: Similarity) -> GaussianScene:
    """A splat in frame a, in frame b: means, axes and sizes of the Gaussians are moved, and their
    harmonics are turned, so that renders stay what they were, to rounding."""
    there = turned(scene, b_from_a.rotation)
    scale = b_from_a.scale
    means = scale * there.means.astype(np.float64)
    shift = b_from_a.apply(scene.origin)  # which may be so large that float32 would not do
    middle = np.median(means, axis=0)
    extent = float(np.median(np.linalg.norm(means - middle, axis=1)))
    origin = far_origin(middle + shift, extent)
    return replace(
        there,
        means=(means + (shift - origin)).astype(np.float32),
        scales=(scale * scene.scales.astype(np.float64)).astype(np.float32),
        near=scale * scene.near,
        origin=origin,
    )
