"""Where the camera probably is, from whoever calls: tracking, odometry, GPS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.geometry.se3 import check_transform


@dataclass(frozen=True, eq=False)
class PosePrior:
    """A pose and how far off it may be. It says where to begin, and never outweighs the photo.

    Attributes:
        cam_from_world: (4, 4) rigid transform.
        translation_sigma: standard deviation of the camera's centre, map units.
        rotation_sigma_degrees: standard deviation of its rotation.

    Raises:
        PoseError: the pose is not a rigid transform, or a deviation is not positive.
    """

    cam_from_world: Float64Array
    translation_sigma: float = 0.05
    rotation_sigma_degrees: float = 2.0

    def __post_init__(self) -> None:
        check_transform(self.cam_from_world, "the prior's cam_from_world")
        for sigma in (self.translation_sigma, self.rotation_sigma_degrees):
            if not 0 < sigma < np.inf:
                raise PoseError(f"a prior's deviations must be positive and finite, not {sigma}")
