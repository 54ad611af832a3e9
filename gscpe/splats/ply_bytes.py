# SPDX-License-Identifier: Apache-2.0
"""Gaussians as the bytes of a standard 3D Gaussian Splatting ``.ply``."""

from __future__ import annotations

import numpy as np

from gscpe.splats.gaussians import GaussianScene

ANTIALIASED_COMMENT = "SplatRenderMode: mip"

_FLOAT32 = np.finfo(np.float32)
_LOG_SCALES = float(np.log(_FLOAT32.smallest_normal)), float(np.log(_FLOAT32.max)) - 1e-5
_MAX_LOGIT = 100.0  # in float32 its sigmoid is 1, and that of its negative 0, exactly


def ply_bytes(scene: GaussianScene, *, means_exponent: int = 0, scales_exponent: int = 0) -> bytes:
    """A binary little-endian ``.ply`` in the layout of the original exporter.

    Properties: position, zero normals, ``f_dc``, ``f_rest`` colour by colour, ``opacity`` as
    a logit, ``scale`` as logarithms, ``rot`` (w, x, y, z); all float32. A header comment
    tells when the splat is antialiased.

    Args:
        means_exponent: centres are multiplied by two to this power.
        scales_exponent: and scales by two to this one.
    """
    count, rest = len(scene), 3 * (scene.sh.shape[1] - 1)
    opacities = scene.opacities.astype(np.float64)
    with np.errstate(divide="ignore"):  # 0 and 1 become infinite, and are clipped
        logits = np.log(opacities) - np.log1p(-opacities)
    log_scales = np.log(scene.scales.astype(np.float64)) + scales_exponent * np.log(2.0)
    table = np.concatenate(
        [
            np.zeros((count, 3), dtype=np.float32),
            scene.sh[:, 0],
            scene.sh[:, 1:].transpose(0, 2, 1).reshape(count, rest),
            np.clip(logits, -_MAX_LOGIT, _MAX_LOGIT).astype(np.float32)[:, None],
            np.clip(log_scales, *_LOG_SCALES).astype(np.float32),
            scene.quaternions,
        ],
        axis=1,
    )
    names = [
        *("nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{i}" for i in range(rest)),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
    far = bool(np.any(scene.origin))  # float32 would round the coordinates
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *([f"comment {ANTIALIASED_COMMENT}"] if scene.antialiased else []),
        f"element vertex {count}",
        *(f"property {'double' if far else 'float'} {axis}" for axis in "xyz"),
        *(f"property float {name}" for name in names),
        "end_header",
    ]
    means = np.ldexp(scene.means.astype(np.float64) + scene.origin, means_exponent)
    rows = np.empty(
        count, dtype=[("means", "<f8" if far else "<f4", 3), ("rest", "<f4", len(names))]
    )
    rows["means"], rows["rest"] = means, table
    return "\n".join(header).encode() + b"\n" + rows.tobytes()
