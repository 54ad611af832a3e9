# SPDX-License-Identifier: Apache-2.0
"""What every matcher offers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, UInt8Array


@dataclass(frozen=True, eq=False)
class Matches:
    """M matches; pixels are (M, 2) float64, the centre of the top-left pixel at (0.5, 0.5).

    Attributes:
        photo_pixels, render_pixels: where the same point is in either image.
        scores: (M,) float32, higher is better; comparable within one call only.
    """

    photo_pixels: Float64Array
    render_pixels: Float64Array
    scores: Float32Array

    def __len__(self) -> int:
        return len(self.scores)

    def __repr__(self) -> str:
        return f"Matches({len(self)})"


def no_matches() -> Matches:
    """What images without features give."""
    return Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, dtype=np.float32))


class Matcher(Protocol):
    """Matches a photo with renders. The photo is prepared once and matched many times."""

    def prepare(self, rgb: UInt8Array, valid: BoolArray | None) -> Any:
        """What :meth:`match` needs to know of an (H, W, 3) uint8 RGB image.

        Only places where ``valid``, (H, W), holds are used; None means all.
        """
        ...

    def match(self, photo: Any, render: Any) -> Matches:
        """Matches between two prepared images."""
        ...
