# SPDX-License-Identifier: Apache-2.0
"""What may be wrong with a splat whose renders do not look like the photos: what was seen comes
first, and a guess only where a test supports it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.pose_error import camera_centres
from gscpe.mapping.looks import Look, PhotoComparison
from gscpe.scene import References
from gscpe.scene.map_frame import typical_depth
from gscpe.splats import GaussianScene

_NOTHING = 0.02
"""Share of a render below which it shows nothing."""

_HUGE = 0.25
"""Gaussians with a standard deviation above this share of the typical depth are huge."""

_ROUNDED = 0.5
"""Steps of coordinates are coarse beyond this share of the Gaussians' median size."""


def diagnose_splat(
    scene: GaussianScene,
    references: References,
    metres_per_unit: float | None,
    photos: PhotoComparison,
    seen: Look,
    min_correlation: float,
    backend: str = "auto",
) -> str | None:
    """What is wrong with the Gaussians themselves, in whatever frame; None where nothing is known.

    Args:
        scene, references: in one world, or what should be one.
        metres_per_unit: see :class:`gscpe.scene.MapFrame`.
        photos: to compare with.
        seen: how the renders of the splat look.
        min_correlation: from which a render looks like its photo.
        backend: as :class:`gscpe.render.Renderer`.
    """
    depth = typical_depth(scene, references)
    sizes = scene.scales.max(axis=1)
    huge = sizes > _HUGE * depth
    if np.count_nonzero(huge) > 0.5 * len(scene):
        found = (
            f"{np.count_nonzero(huge)} of {len(scene)} Gaussians are about as large as the scene "
            f"(median standard deviation {np.median(sizes):.3g}, where what the cameras see is "
            f"{depth:.3g} units away), and cover everything"
        )
        return f"{found}: {_about_scales(scene, references, metres_per_unit, photos, backend)}"
    if np.any(huge):
        left = scene.taken(~huge)
        look = photos.look(left, references, metres_per_unit, backend)
        if look.best >= min_correlation and look.best > 2.0 * max(seen.best, 0.0):
            return (
                f"{np.count_nonzero(huge)} of {len(scene)} Gaussians are as large as the scene "
                f"(standard deviations from {sizes[huge].min():.3g} to {sizes.max():.3g} units) "
                f"and hide it: without them the renders look like the photos (correlation "
                f"{look.best:.2f}). Remove them; rows of zeros in a .ply read so"
            )
    return rounded_coordinates(scene)


def _about_scales(
    scene: GaussianScene,
    references: References,
    metres_per_unit: float | None,
    photos: PhotoComparison,
    backend: str,
) -> str:
    advice = "export it with logarithmic scales, as 3DGS does"
    if scene.scales.min() <= 1.0:
        return f"the scales seem to be wrong; are they logarithms? {advice}"
    lengths = np.maximum(np.log(scene.scales.astype(np.float64)), 1e-12).astype(np.float32)
    look = photos.look(replace(scene, scales=lengths), references, metres_per_unit, backend)
    return (
        "the file holds its scales as lengths, where logarithms of them belong (read as "
        f"lengths, the renders look like the photos to a correlation of {look.best:.2f}); {advice}"
    )


def rounded_coordinates(scene: GaussianScene) -> str | None:
    """Whether the Gaussians stand on the grid of float32 numbers, far from zero, and that grid
    is coarse against their size; None where it is not."""
    if not np.any(scene.origin):
        return None
    world = scene.means.astype(np.float64) + scene.origin
    as_float32 = world.astype(np.float32)
    step = float(np.spacing(np.abs(as_float32).max()))
    size = float(np.median(scene.scales))
    if step <= _ROUNDED * size or not np.array_equal(as_float32.astype(np.float64), world):
        return None
    return (
        f"the splat's coordinates reach {np.abs(world).max():.3g} and are stored as 32-bit floats, "
        f"in steps of {step:.2g} units, where Gaussians are {size:.2g} units wide: their places "
        "are lost. Export the splat relative to an origin nearby, or with 64-bit coordinates"
    )


def what_was_seen(scene: GaussianScene, references: References, seen: Look) -> str:
    """In words, where the Gaussians themselves look right."""
    count = len(seen.correlations)
    if max(seen.coverage) < _NOTHING:
        where = _where(scene, references)
        return f"nothing of the splat is visible from {count} reference poses: {where}"
    covered = float(np.median(seen.coverage))
    return (
        f"the splat does not look like the photos: renders from {count} reference poses show it "
        f"on {covered:.0%} of the picture, and correlate with the photos to {seen.best:.2f} at best"
    )


def _where(scene: GaussianScene, references: References) -> str:
    """Where cameras and Gaussians are, in numbers."""
    means = scene.means.astype(np.float64)
    middle = np.median(means, axis=0)
    extent = float(np.median(np.linalg.norm(means - middle, axis=1)))
    centres = camera_centres(references.cam_from_world)
    cameras = np.median(centres, axis=0)
    spread = float(np.median(np.linalg.norm(centres - cameras, axis=1)))
    apart = float(np.linalg.norm(cameras - scene.origin - middle))
    text = (
        f"the cameras stand around ({_numbers(cameras)}), {spread:.3g} units apart, the splat "
        f"around ({_numbers(scene.origin + middle)}), {extent:.3g} units wide"
    )
    if apart > 10.0 * max(extent, spread):
        return f"{text}, {apart:.3g} units away from them: one of both has another origin"
    ahead = [
        float(np.mean(means @ pose[2, :3] + pose[2, :3] @ scene.origin + pose[2, 3] > 0))
        for pose in references.cam_from_world[:: max(1, len(references) // 20)]
    ]
    if float(np.median(ahead)) < 0.1:
        return (
            f"{text}, and behind the cameras: are the poses camera-to-world, or the axes OpenGL's?"
        )
    if spread > 30.0 * extent or extent > 300.0 * max(spread, 1e-12):
        return f"{text}: one of both has another unit"
    return text


def _numbers(point: Float64Array) -> str:
    return ", ".join(f"{x:.6g}" for x in point)
