"""What localization needs to know about a place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.errors import MapError
from gscpe.scene.gaussians import GaussianScene
from gscpe.scene.references import GlobalDescriptors, References


@dataclass(frozen=True, eq=False)
class Map:
    """A Gaussian splat, its reference photos' poses, and their global descriptors.

    Attributes:
        metres_per_unit: of all coordinates; None where it is not known.
    """

    scene: GaussianScene
    references: References
    descriptors: GlobalDescriptors
    metres_per_unit: float | None = 1.0

    def __post_init__(self) -> None:
        if self.metres_per_unit is not None and not 0 < self.metres_per_unit < np.inf:
            raise MapError(f"metres per unit must be positive, not {self.metres_per_unit}")
        if len(self.references) != len(self.descriptors.descriptors):
            raise MapError("a map needs one global descriptor for each reference photo")

    def __repr__(self) -> str:
        unit = self.metres_per_unit
        length = "of unknown length" if unit is None else f"= {unit:g} m"
        return (
            f"Map({len(self.scene)} Gaussians, {len(self.references)} reference photos "
            f"described by {self.descriptors.method}, 1 unit {length})"
        )
