# SPDX-License-Identifier: Apache-2.0
"""Photos that a map was not made of are localized in it, for its certificate."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float32Array, Float64Array, UInt8Array
from gscpe.errors import MapError
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centres, pose_difference
from gscpe.geometry.spread import thinned
from gscpe.localization import Localizer
from gscpe.making.certificate import Certificate, CertifiedPhoto
from gscpe.making.settings import CertificateSettings
from gscpe.photos import Photo, read_image_of, to_photo
from gscpe.scene import Map, References


def certify(
    map_: Map,
    left_out: References,
    image_folder: str | Path,
    settings: CertificateSettings | None = None,
    backend: str = "auto",
    matcher: str | None = None,
    progress: bool = False,
) -> tuple[Certificate, dict[str, tuple[Float32Array, Float32Array]]]:
    """Localizes photos that a map was not made of.

    Args:
        map_: to localize in.
        left_out: names, cameras and poses of the photos, in the world of the map.
        image_folder: where they are.
        settings: of the verdict, and how many pictures there are to be.
        backend, matcher: as :class:`gscpe.Localizer`.
        progress: show a bar.

    Returns:
        The certificate, and photo and render, (H, W, 3) in [0, 1], of the worst photos and of some
        others, by name.

    Raises:
        MapError: there are no such photos.
        PhotoError, CameraError: one cannot be used.
    """
    settings = settings or CertificateSettings()
    if not len(left_out):
        raise MapError("a certificate needs photos that the map was not made of")
    photos: list[CertifiedPhoto] = []
    images: dict[str, tuple[Float32Array, Float32Array]] = {}
    depths: list[float] = []
    with Localizer(map_, matcher=matcher, backend=backend, progress=progress) as localizer:
        for name, pose, camera in tqdm(
            list(zip(left_out.names, left_out.cam_from_world, left_out.cameras, strict=True)),
            desc="certifying the map",
            unit="photo",
            disable=not progress,
        ):
            image = read_image_of(Path(image_folder) / name, camera)
            photo, pictures, depth = certified_photo(localizer, name, image, camera, pose)
            photos.append(photo)
            images[name] = pictures
            depths += [depth] if depth else []
    certificate = Certificate(
        photos=tuple(photos),
        scene_size=scene_size(
            map_.world_references.cam_from_world, left_out.cam_from_world, depths
        ),
        metres_per_unit=map_.metres_per_unit,
        learned=len(map_.references),
        gaussians=len(map_.scene),
        settings=settings,
    )
    kept = _to_show([photo.name for photo in certificate.worst_first()], settings.pictures)
    return certificate, {name: images[name] for name in kept}


def certified_photo(
    localizer: Localizer,
    name: str,
    image: UInt8Array,
    camera: Camera,
    cam_from_world: Float64Array,
) -> tuple[CertifiedPhoto, tuple[Float32Array, Float32Array], float]:
    """Localizes a photo, and renders the map from where it was taken.

    Args:
        localizer: of the map.
        name: of the photo.
        image: (H, W, 3) uint8.
        camera: of it.
        cam_from_world: (4, 4), its pose.

    Returns:
        What came of it; photo and render, (H, W, 3) in [0, 1]; the median depth, world units, 0
        where nothing is seen.
    """
    result = localizer.localize(image, camera)
    photo = localizer.at_the_maps_resolution(to_photo(image, camera))
    view = localizer.render(photo.camera, cam_from_world)
    depth = float(np.median(view.depth[view.depth > 0])) if np.any(view.depth > 0) else 0.0
    shown = np.clip(view.rgb, 0.0, 1.0)
    truth = photo.rgb.astype(np.float32) / np.float32(255.0)
    distance = degrees = None
    if result.cam_from_world is not None:
        off = pose_difference(result.cam_from_world, cam_from_world)
        distance, degrees = float(off.distance), float(off.degrees)
    likeness = _likeness(photo, truth, shown)
    certified = CertifiedPhoto(name, result.reason, distance, degrees, *likeness)
    return certified, (truth, shown), depth


def _likeness(photo: Photo, truth: Float32Array, shown: Float32Array) -> tuple[float, float, float]:
    """PSNR as it is and with exposure fitted, and SSIM (Wang et al., 2004), of what is valid."""
    from skimage.metrics import structural_similarity

    valid = np.ones(truth.shape[:2], dtype=bool) if photo.valid is None else photo.valid
    _, similar = structural_similarity(
        truth, shown, channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    x, y = shown[valid], truth[valid]
    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    covariance = ((x - mean_x) * (y - mean_y)).mean(axis=0)
    gain = covariance / np.maximum(((x - mean_x) ** 2).mean(axis=0), 1e-9)
    fitted = np.clip(gain * (x - mean_x) + mean_y, 0.0, 1.0)
    return _psnr(x, y), _psnr(fitted, y), float(np.mean(similar[valid]))


def _psnr(x: Float32Array, y: Float32Array) -> float:
    return -10.0 * float(np.log10(max(float(np.mean((x - y) ** 2)), 1e-10)))


def scene_size(references: Float64Array, left_out: Float64Array, depths: Sequence[float]) -> float:
    """World units: the largest distance between two cameras, or the median depth.

    Args:
        references, left_out: (N, 4, 4) and (M, 4, 4), world to camera.
        depths: median of each of those left out.
    """
    centres = camera_centres(np.concatenate([references, left_out]))
    apart = max(float(np.linalg.norm(centres - centre, axis=1).max()) for centre in centres)
    return max(apart, float(np.median(depths)) if depths else 0.0, 1e-12)


def _to_show(worst_first: Sequence[str], count: int) -> list[str]:
    """The worst half, and of the others every so many; in this order."""
    if len(worst_first) <= count:
        return list(worst_first)
    worst = (count + 1) // 2
    return [*worst_first[:worst], *thinned(worst_first[worst:], count - worst)]
