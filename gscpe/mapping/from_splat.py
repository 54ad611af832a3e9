# SPDX-License-Identifier: Apache-2.0
"""A map from a trained splat and the photos that it was trained on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscpe.errors import MapError, SplatError
from gscpe.mapping.reference_photos import reference_photo
from gscpe.photos.photo import LazyPhotos
from gscpe.ranges import check_numbers
from gscpe.retrieval import describe_references, parse_method
from gscpe.scene import GlobalDescriptors, Map, References
from gscpe.splats import GaussianScene


@dataclass(frozen=True)
class MapSettings:
    """What is kept in a map besides the splat.

    Attributes:
        retrieval: how the reference photos are described: "vlad", "vlad-xfeat", or "onnx:PATH"
            with the path of an exported network.
        metres_per_unit: of the splat's coordinates; None where it is not known.
    """

    retrieval: str = "vlad"
    metres_per_unit: float | None = 1.0

    def __post_init__(self) -> None:
        parse_method(self.retrieval)
        check_numbers(self, "metres_per_unit", above=0, optional=True)


def build_map(
    scene: GaussianScene,
    references: References,
    image_folder: str | Path,
    settings: MapSettings | None = None,
    *,
    progress: bool = False,
) -> Map:
    """A map of a splat and reference photos with known poses, in the frame of the splat.

    Raises:
        PhotoError: a reference photo cannot be read.
        CameraError: a reference photo is of another size than its camera.
        SplatError: the scene is something else, a path for example.
        MapError: there are no references, or they are something else.
        ModelError: the network that is to describe them is missing, or cannot be used.
        MissingDependencyError: it needs onnxruntime, and that is not installed.
    """
    check_scene(scene)
    if not isinstance(references, References):
        raise MapError(
            f"references must be References, not a {type(references).__name__}; "
            "gscpe.read_colmap_references reads them from a COLMAP model"
        )
    settings = settings or MapSettings()
    photos = LazyPhotos(
        len(references), lambda index: reference_photo(references, index, Path(image_folder))
    )
    return Map.of(
        scene=scene,
        references=references,
        descriptors=describe_references(photos, settings.retrieval, progress),
        metres_per_unit=settings.metres_per_unit,
    )


def map_without_references(scene: GaussianScene, metres_per_unit: float | None = 1.0) -> Map:
    """A map of a splat alone: it recognizes no place, so each query needs a prior pose.

    Raises:
        SplatError: the scene is something else, a path for example.
    """
    check_scene(scene)
    nothing = np.zeros((0, 0), dtype=np.float32)
    return Map.of(
        scene=scene,
        references=References((), np.zeros((0, 4, 4)), ()),
        descriptors=GlobalDescriptors(vocabulary=nothing, descriptors=nothing),
        metres_per_unit=metres_per_unit,
    )


def check_scene(scene: GaussianScene) -> None:
    """Raises SplatError where the scene is something else."""
    if not isinstance(scene, GaussianScene):
        raise SplatError(
            f"a map is made of a GaussianScene, not of a {type(scene).__name__}; "
            "gscpe.read_splat reads one"
        )
