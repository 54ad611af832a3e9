"""How sharp a picture is, whatever its contrast and size."""

from __future__ import annotations

import cv2
import numpy as np

from gscpe.arrays import UInt8Array

_COMPARED = 640


def sharpness(rgb: UInt8Array) -> float:
    """Finest detail, as a share of the coarser: the ratio of the mean gradients' energy between the
    bands below 1 and of 1 to 4 pixels, at 640 pixels. 0.4 to 0.9 for a sharp photo, 0.15 for one
    that is blurred by 2 pixels (standard deviation), 0.07 by 5.

    Args:
        rgb: (H, W, 3) uint8, or grey, (H, W).
    """
    grey = rgb if rgb.ndim == 2 else cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    scale = _COMPARED / max(grey.shape)
    if scale < 1.0:  # noise averages out
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    image = grey.astype(np.float32)
    fine = cv2.GaussianBlur(image, (0, 0), 1.0)
    coarse = cv2.GaussianBlur(image, (0, 0), 4.0)
    detail, structure = float(np.mean((image - fine) ** 2)), float(np.mean((fine - coarse) ** 2))
    # Rounding to 8 bits alone is a detail of 1/12.
    return float(np.sqrt(max(detail - 0.1, 0.0) / max(structure, 0.5)))
