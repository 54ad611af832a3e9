"""Photos that are exposed so long that their brightest parts are clipped.

A gain and a bias fitted over clipped pixels are far off, and leaving these pixels out is no
better: which ones are clipped depends on their noise. So the render is exposed like the photo,
clipping included, before the two are compared.
"""

from __future__ import annotations

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, UInt8Array

_CLIPPED = 254
_MANY = 0.02
_BLOCK = 8
"""Pixels whose means are compared: the poses are not exact yet."""
_SOFT = 0.03
"""Differences beyond this count linearly."""


def is_clipped(photo: UInt8Array) -> bool:
    """Whether more than 2% of the pixels, (H, W, 3), are as bright as can be in a channel."""
    red, green, blue = np.moveaxis(photo[::2, ::2], 2, 0)
    brightest = np.maximum(np.maximum(red, green), blue)
    return bool(np.count_nonzero(brightest >= _CLIPPED) > _MANY * brightest.size)


def fit_exposure(
    render: Float32Array, photo: UInt8Array, shown: BoolArray
) -> tuple[float, float] | None:
    """Gain and bias of ``photo = min(gain * render + bias, 1)``; None when little is shown.

    Args:
        render: (H, W, 3), in [0, 1].
        photo: (H, W, 3) uint8, from about the same pose.
        shown: (H, W), where the render shows the map.
    """
    from scipy.optimize import least_squares

    height, width = (max(1, side // _BLOCK) for side in shown.shape)
    rendered, seen, clipped, whole = (
        cv2.resize(image.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        for image in (render, photo / np.float32(255.0), photo >= _CLIPPED, shown)
    )
    # The mean of a block that is clipped in part follows neither line.
    usable = (whole[..., None] > 0.9) & ((clipped < 0.02) | (clipped > 0.98))
    if np.count_nonzero(usable) < 60:
        return None
    rendered, seen = rendered[usable], seen[usable]

    def differences(light: Float64Array) -> Float64Array:
        return np.asarray(np.minimum(light[0] * rendered + light[1], 1.0) - seen).ravel()

    fits = [
        least_squares(differences, (gain, 0.0), loss="soft_l1", f_scale=_SOFT)
        for gain in (1.0, 2.0)  # where all is clipped, the first has no slope
    ]
    gain, bias = min(fits, key=lambda fit: float(fit.cost)).x
    return (float(gain), float(bias)) if gain > 0 else None


def expose(render: Float32Array, gain: float, bias: float) -> Float32Array:
    """The render, (H, W, 3), as a camera with this exposure takes it."""
    exposed = np.clip(np.float32(gain) * render + np.float32(bias), 0.0, 1.0)
    return np.asarray(exposed, dtype=np.float32)
