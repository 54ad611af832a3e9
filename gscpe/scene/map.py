# SPDX-License-Identifier: Apache-2.0
"""What localization needs to know about a place."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gscpe.errors import MapError
from gscpe.scene.map_frame import MapFrame, typical_depth
from gscpe.scene.references import GlobalDescriptors, References
from gscpe.splats.gaussians import GaussianScene


@dataclass(frozen=True, eq=False)
class Map:
    """A Gaussian splat, its reference photos' poses, and their global descriptors.

    Scene and references are in the map's own frame, near its origin and in metres; see
    :class:`MapFrame`.

    Attributes:
        scene: the splat.
        references: ``cam_from_world`` of the photos, where the world is the map's own frame;
            :attr:`world_references` has them in the frame that the map was built in.
        descriptors: one for each reference photo.
        frame: where the map's frame lies in the world.
    """

    scene: GaussianScene
    references: References
    descriptors: GlobalDescriptors
    frame: MapFrame = field(default_factory=MapFrame)

    def __post_init__(self) -> None:
        if np.any(self.scene.origin):
            raise MapError("the scene of a map must be in the map's frame; use Map.of")
        if len(self.references) != len(self.descriptors.descriptors):
            raise MapError("a map needs one global descriptor for each reference photo")

    @classmethod
    def of(
        cls,
        scene: GaussianScene,
        references: References,
        descriptors: GlobalDescriptors,
        metres_per_unit: float | None = 1.0,
    ) -> Map:
        """A map of a splat and references that are in one frame, the world.

        Args:
            scene, references: in the world.
            descriptors: of the references.
            metres_per_unit: length of a world unit in metres; None where it is not known.
        """
        frame = MapFrame.around(scene, references, metres_per_unit)
        return cls(
            scene=frame.scene_in_map(scene, typical_depth(scene, references)),
            references=frame.references_in_map(references),
            descriptors=descriptors,
            frame=frame,
        )

    @property
    def metres_per_unit(self) -> float | None:
        """Length of a unit of the world in metres; None where it is not known."""
        return self.frame.metres_per_unit

    @property
    def world_references(self) -> References:
        """The references in the frame that the map was built in, the world."""
        poses = self.frame.cam_from_world(self.references.cam_from_world)
        return replace(self.references, cam_from_world=poses)

    def __repr__(self) -> str:
        unit = self.metres_per_unit
        length = "of unknown length" if unit is None else f"= {unit:g} m"
        return (
            f"Map({len(self.scene)} Gaussians, {self.references.count_text()} "
            f"described by {self.descriptors.method}, 1 unit {length})"
        )
