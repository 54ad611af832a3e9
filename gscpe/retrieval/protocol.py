# SPDX-License-Identifier: Apache-2.0
"""What every global description offers."""

from __future__ import annotations

from typing import Protocol

from gscpe.arrays import BoolArray, Float32Array, UInt8Array
from gscpe.features.xfeat import XFeatFeatures


class GlobalDescriber(Protocol):
    """Describes what a photo shows by one vector, so that photos of a place are alike."""

    def describe(
        self, rgb: UInt8Array, local: XFeatFeatures | None = None, valid: BoolArray | None = None
    ) -> Float32Array:
        """The descriptor, (D,) float32 of unit length; all zero where there is nothing to
        describe.

        Args:
            rgb: (H, W, 3) uint8.
            local: XFeat's features of this very image, best first, where they are known
                already; methods that are made of them do not detect them again.
            valid: (H, W), where the image shows something; None: everywhere.

        Raises:
            ModelError: a trained network cannot be run.
        """
        ...
