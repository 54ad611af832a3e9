# SPDX-License-Identifier: Apache-2.0
"""References: what a map knows about the places it was built from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float32Array, Float64Array, short_repr
from gscpe.errors import MapError
from gscpe.geometry.camera import Camera
from gscpe.geometry.se3 import check_transform


@dataclass(frozen=True, eq=False)
class References:
    """Names, poses and cameras of the N reference photos.

    Attributes:
        names: N file names, relative to the image folder.
        cam_from_world: (N, 4, 4) float64.
        cameras: N cameras.
        virtual: whether they are renders of the splat, not photos; their names then name no files.
    """

    names: tuple[str, ...]
    cam_from_world: Float64Array
    cameras: tuple[Camera, ...]
    virtual: bool = False

    def __post_init__(self) -> None:
        if not len(self.names) == len(self.cam_from_world) == len(self.cameras):
            raise MapError("references need as many names as poses and cameras")
        for name, cam_from_world in zip(self.names, self.cam_from_world, strict=True):
            check_transform(cam_from_world, f"cam_from_world of reference {name}")

    def __len__(self) -> int:
        return len(self.names)

    def count_text(self) -> str:
        """How many there are of which kind, for people."""
        return f"{len(self)} {'virtual references' if self.virtual else 'reference photos'}"

    def __repr__(self) -> str:
        if len(self) < 3:
            return f"References({', '.join(self.names)})"
        kind = "renders" if self.virtual else "photos"
        return f"References({len(self)} {kind}: {self.names[0]}, ..., {self.names[-1]})"


@dataclass(frozen=True)
class DescriberModel:
    """Which exported network described the references.

    Attributes:
        file: its name, without folder.
        sha256: of the file, and of its separate weights where it has some.
        input: how a photo becomes its input, as JSON.
    """

    file: str
    sha256: str
    input: str


@dataclass(frozen=True, eq=False)
class GlobalDescriptors:
    """One descriptor for each reference photo, and what is needed to describe a query in the same
    way.

    Attributes:
        vocabulary: (K, C) float32, the visual words; (0, 0) for methods without.
        descriptors: (N, D) float32, of unit length, or all zero.
        method: "vlad", "vlad-xfeat" or "onnx"; see gscpe.retrieval.
        model: of the method "onnx"; else None.
    """

    vocabulary: Float32Array
    descriptors: Float32Array
    method: str = "vlad"
    model: DescriberModel | None = None

    def __post_init__(self) -> None:
        if self.vocabulary.ndim != 2 or self.descriptors.ndim != 2:
            raise MapError("vocabulary and descriptors must be matrices")
        if not (np.all(np.isfinite(self.vocabulary)) and np.all(np.isfinite(self.descriptors))):
            raise MapError("vocabulary and descriptors must be finite")

    def __repr__(self) -> str:
        return short_repr(self)
