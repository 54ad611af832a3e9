# SPDX-License-Identifier: Apache-2.0
"""A map that holds no photos is certified by renders from beside its viewpoints."""

from __future__ import annotations

from typing import Iterator

import cv2
import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.errors import MapError
from gscpe.geometry import se3
from gscpe.geometry.pose_error import camera_centre, camera_centres
from gscpe.geometry.spread import evenly_spread
from gscpe.localization import Localizer
from gscpe.making.certificate import Certificate, CertifiedPhoto
from gscpe.making.certify import certified_photo, scene_size
from gscpe.making.settings import CertificateSettings
from gscpe.photos import to_uint8
from gscpe.render import RenderedView, Renderer
from gscpe.scene import Map, References
from gscpe.viewpoints import times_seen

_TURN_DEGREES = 10.0
"""Standard deviation of the turns between a viewpoint and a render, about each axis."""
_ENOUGH, _NEAR = 0.6, 0.2
"""Share of a render that must show the map, and of the median depth that a twentieth may be nearer
than: people do not hold cameras into furniture."""
_DRAWN = 20
"""Poses that are drawn for a render before it is left out."""
_DIMMER, _BLUR, _NOISE = 0.85, 1.0, 4.0
"""A photo is not as perfect as a render of its own map: brightness, pixels, and grey levels."""


def certify_virtual(
    map_: Map,
    settings: CertificateSettings | None = None,
    backend: str = "auto",
    matcher: str | None = None,
    progress: bool = False,
) -> Certificate:
    """Localizes renders in a map whose references are renders too, and counts what of the splat
    the references show.

    Their poses lie between neighbouring viewpoints, turned by some ten degrees. They are darkened,
    blurred and made noisy. This shows whether places are recognized and told from each other, and
    whether the splat can be aligned with. Photos are taken where the splat is detailed, also where
    no viewpoint was found, and no render from beside a viewpoint tells that: so it is also counted
    which share of the splat's Gaussians enough references show (``Certificate.seen``). Whether
    photos look like the splat, nothing here can tell. The same every time.

    Args:
        map_: with virtual references.
        settings: of the verdict, and how many renders.
        backend, matcher: as :class:`gscpe.Localizer`.
        progress: show a bar.

    Raises:
        MapError: the map's references are not virtual; or from nowhere between the viewpoints it
            can be seen.
        RenderError, ModelError, MissingDependencyError: of :class:`gscpe.Localizer`.
    """
    settings = settings or CertificateSettings()
    references = map_.world_references
    if not references.virtual:
        raise MapError("only a map of virtual references is certified by renders")
    photos: list[CertifiedPhoto] = []
    poses: list[Float64Array] = []
    depths: list[float] = []
    rng = np.random.default_rng(0)
    seen = _share_seen(map_, settings.least_views, backend)
    with Localizer(map_, matcher=matcher, backend=backend, progress=progress) as localizer:
        for number, index in enumerate(
            tqdm(
                evenly_spread(len(references), settings.renders),
                "certifying the map",
                unit="render",
                disable=not progress,
            )
        ):
            camera = references.cameras[index]
            found = _view_beside(localizer, references, index, rng)
            if found is None:
                continue
            pose, view = found
            image = _as_a_photo(to_uint8(view.rgb), rng)
            photo, _, median = certified_photo(localizer, f"render {number}", image, camera, pose)
            photos.append(photo)
            poses.append(pose)
            depths.append(median)
    if not photos:
        raise MapError("the map cannot be certified: beside its viewpoints, nothing is seen")
    return Certificate(
        photos=tuple(photos),
        scene_size=scene_size(references.cam_from_world, np.array(poses), depths),
        metres_per_unit=map_.metres_per_unit,
        learned=len(references),
        gaussians=len(map_.scene),
        settings=settings,
        of_renders=True,
        seen=seen,
    )


def _view_beside(
    localizer: Localizer, references: References, index: int, rng: np.random.Generator
) -> tuple[Float64Array, RenderedView] | None:
    """Pose, (4, 4), and render, as someone might take a photo near a reference; None where the map
    does not show enough."""
    for pose in _beside(references.cam_from_world, index, rng):
        view = localizer.render(references.cameras[index], pose)
        depth = view.depth[view.opacity > 0.5]
        if depth.size >= _ENOUGH * view.depth.size and (
            np.quantile(depth, 0.05) >= _NEAR * np.median(depth)
        ):
            return pose, view
    return None


def _share_seen(map_: Map, least: int, backend: str) -> float:
    """The share of a map's Gaussians that at least so many references show; in a map of few, a
    tenth of them."""
    references = map_.references
    enough = max(1, min(least, len(references) // 10))
    with Renderer(map_.scene, backend) as renderer:
        times = times_seen(map_.scene, references.cam_from_world, references.cameras, renderer)
    return float(np.mean(times >= enough))


def _beside(
    cam_from_world: Float64Array, index: int, rng: np.random.Generator
) -> Iterator[Float64Array]:
    """Poses, (4, 4), on the way from a reference to the nearest that stands elsewhere, turned;
    turned only, where all stand at one place."""
    centres = camera_centres(cam_from_world)
    apart = np.linalg.norm(centres - centres[index], axis=1)
    others = apart > 1e-6 * max(float(apart.max()), 1e-300)
    nearest = int(np.where(others, apart, np.inf).argmin()) if others.any() else index
    step = centres[nearest] - centres[index]
    for _ in range(_DRAWN):
        pose = cam_from_world[index].copy()
        centre = camera_centre(pose) + rng.uniform(0.2, 0.8) * step
        turn = np.deg2rad(_TURN_DEGREES) * rng.normal(size=3)
        pose[:3, 3] = -pose[:3, :3] @ centre
        yield np.asarray(se3.exp([0.0, 0.0, 0.0, *turn]) @ pose)


def _as_a_photo(rgb: UInt8Array, rng: np.random.Generator) -> UInt8Array:
    blurred = cv2.GaussianBlur(_DIMMER * rgb.astype(np.float32), (0, 0), _BLUR)
    noisy = blurred + rng.normal(scale=_NOISE, size=rgb.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)
