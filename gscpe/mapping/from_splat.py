"""A map from a trained splat and the photos that it was trained on."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Iterable

import numpy as np
from tqdm import tqdm

from gscpe.arrays import UInt8Array
from gscpe.errors import MapError, SettingsError
from gscpe.geometry.camera import Camera
from gscpe.retrieval import VladSettings, describe_image, learn_vocabulary, local_descriptors
from gscpe.scene import GaussianScene, GlobalDescriptors, Map, References, read_image, to_photo


@dataclass(frozen=True)
class MapSettings:
    """What is kept in a map besides the splat.

    Attributes:
        retrieval: global descriptors of the reference photos.
        metres_per_unit: of the splat's coordinates; None where it is not known.
    """

    retrieval: VladSettings = field(default_factory=VladSettings)
    metres_per_unit: float | None = 1.0

    def __post_init__(self) -> None:
        if self.metres_per_unit is not None and not 0 < self.metres_per_unit < np.inf:
            raise SettingsError(f"metres per unit must be positive, not {self.metres_per_unit}")


def build_map(
    scene: GaussianScene,
    references: References,
    image_folder: str | Path,
    settings: MapSettings | None = None,
    progress: bool = False,
) -> Map:
    """A map of a splat and reference photos with known poses, in the frame of the splat.

    Raises:
        PhotoError: a reference photo cannot be read.
        CameraError: a reference photo is of another size than its camera.
        MapError: there are no references.
    """
    settings = settings or MapSettings()
    folder = Path(image_folder)
    photos = (
        _reference_photo(folder / name, camera)
        for name, camera in zip(references.names, references.cameras, strict=True)
    )
    shown = tqdm(
        photos,
        desc="describing reference photos",
        total=len(references),
        unit="photo",
        disable=not progress,
    )
    return Map(
        scene=scene,
        references=references,
        descriptors=describe_references(shown, settings.retrieval),
        metres_per_unit=settings.metres_per_unit,
    )


def _reference_photo(path: Path, camera: Camera) -> UInt8Array:
    image = read_image(path)
    camera.check_fits(image.shape, f"reference photo {path}")
    return to_photo(image, camera).rgb


def describe_references(photos: Iterable[UInt8Array], settings: VladSettings) -> GlobalDescriptors:
    """Learns a vocabulary from photos, (H, W, 3) uint8 RGB, and describes each with it.

    Raises:
        MapError: there are no photos.
    """
    local = [local_descriptors(rgb, settings) for rgb in photos]
    if not local:
        raise MapError("a map needs at least one reference photo")
    vocabulary = learn_vocabulary(local, settings)
    return GlobalDescriptors(
        vocabulary=vocabulary,
        descriptors=np.stack([describe_image(each, vocabulary) for each in local]),
    )
