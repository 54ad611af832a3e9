# SPDX-License-Identifier: Apache-2.0
"""Spherical harmonics and their slopes: loops compiled by Numba. Constants and signs are those of
3DGS, as in gscpe.render.cpu_projection."""

from __future__ import annotations

import numpy as np

from gscpe.render.compiled import compiled
from gscpe.render.cpu_projection import FAST

_F = np.float32
_C1 = _F(0.4886025119029199)
_C4, _C6, _C8 = _F(1.0925484305920792), _F(0.31539156525252005), _F(0.5462742152960396)
_C9, _C10, _C11 = _F(0.5900435899266435), _F(2.890611442640554), _F(0.4570457994644658)
_C12, _C14 = _F(0.3731763325901154), _F(1.445305721320277)

C0 = _F(0.28209479177387814)


@compiled(fastmath=FAST)
def fill_basis(basis, count, x, y, z):
    """The first ``count`` (1, 4, 9 or 16) harmonics of a unit direction."""
    basis[0] = C0
    if count > 1:
        basis[1], basis[2], basis[3] = -_C1 * y, _C1 * z, -_C1 * x
    if count > 4:
        xx, yy, zz = x * x, y * y, z * z
        basis[4], basis[5], basis[7] = _C4 * x * y, -_C4 * y * z, -_C4 * x * z
        basis[6] = _C6 * (_F(2.0) * zz - xx - yy)
        basis[8] = _C8 * (xx - yy)
        if count > 9:
            three, four = _F(3.0), _F(4.0)
            basis[9] = -_C9 * y * (three * xx - yy)
            basis[10] = _C10 * x * y * z
            basis[11] = -_C11 * y * (four * zz - xx - yy)
            basis[12] = _C12 * z * (_F(2.0) * zz - three * xx - three * yy)
            basis[13] = -_C11 * x * (four * zz - xx - yy)
            basis[14] = _C14 * z * (xx - yy)
            basis[15] = -_C9 * x * (xx - three * yy)


@compiled(fastmath=FAST)
def slope_of_sum(s, count, x, y, z):
    """The gradient of ``sum of s[k] * basis[k]`` with respect to the direction, as if x, y and z
    were free."""
    two, three, four, six = _F(2.0), _F(3.0), _F(4.0), _F(6.0)
    gx, gy, gz = _F(0.0), _F(0.0), _F(0.0)
    if count > 1:
        gx, gy, gz = -_C1 * s[3], -_C1 * s[1], _C1 * s[2]
    if count > 4:
        gx += _C4 * (y * s[4] - z * s[7]) + two * x * (_C8 * s[8] - _C6 * s[6])
        gy += _C4 * (x * s[4] - z * s[5]) - two * y * (_C8 * s[8] + _C6 * s[6])
        gz += four * _C6 * z * s[6] - _C4 * (y * s[5] + x * s[7])
    if count > 9:
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        gx += (
            -six * _C9 * xy * s[9] + _C10 * yz * s[10] + two * _C11 * xy * s[11]
            - six * _C12 * xz * s[12] - _C11 * (four * zz - three * xx - yy) * s[13]
            + two * _C14 * xz * s[14] - three * _C9 * (xx - yy) * s[15]
        )  # fmt: skip
        gy += (
            -three * _C9 * (xx - yy) * s[9] + _C10 * xz * s[10]
            - _C11 * (four * zz - xx - three * yy) * s[11] - six * _C12 * yz * s[12]
            + two * _C11 * xy * s[13] - two * _C14 * yz * s[14] + six * _C9 * xy * s[15]
        )  # fmt: skip
        gz += (
            _C10 * xy * s[10] - _F(8.0) * _C11 * (yz * s[11] + xz * s[13])
            + _C12 * (six * zz - three * xx - three * yy) * s[12] + _C14 * (xx - yy) * s[14]
        )  # fmt: skip
    return gx, gy, gz
