# SPDX-License-Identifier: Apache-2.0
"""Gaussians as the bytes of Niantic's ``.spz`` (version 3), through gaussforge.

Source of the layout: the README of github.com/nianticlabs/spz. A gzip stream begins with
16 bytes of header; byte 13 is the number of fractional bits of the 24-bit coordinates, bit
0 of byte 14 the antialiased flag. The harmonics, a byte each, come last. gaussforge always
writes 12 fractional bits, no flag, and harmonics in steps of 1/16 and 1/8, which costs
accuracy (docs/formats.md). So these are set here; the coordinates that it is given are
shifted to match.
"""

from __future__ import annotations

import gzip
import math
import struct

import numpy as np

from gscpe.errors import OutputError
from gscpe.splats.gaussians import GaussianScene
from gscpe.splats.ply_bytes import ply_bytes
from gscpe.splats.through_gaussforge import from_ply

_HEADER = struct.Struct("<4sIIBBBB")  # magic, version, count, degree, fractional bits, flags, 0
_WRITTEN_FRACTIONAL_BITS = 12
_MAX_FRACTIONAL_BITS = 30  # readers compute 1 << bits in 32-bit integers
_MAX_COORDINATE = 2**23 - 1
_LOG_SCALES = -10.0, 5.9375  # what a byte holds, in steps of 1/16
_MAX_SPECK_SHARE = 0.01


def encode_spz(scene: GaussianScene, exponent: int = 0) -> bytes:
    """The scene with all lengths multiplied by two to the power of ``exponent``.

    Coordinates are stored with as many fractional bits as their range allows: with steps of
    at most 2**-22 of the largest one. Scales have steps of 6%, opacities of 1/255, the
    coefficients of the base colour of 1/38 and harmonics of 1/64; values beyond the range of
    a byte, and scales below exp(-10), are clipped.

    Raises:
        OutputError: coordinates or scales are too large for the format, or more than 1% of
            the Gaussians are smaller than exp(-10) along all axes and would be enlarged.
        MissingDependencyError: gaussforge is not installed.
    """
    if np.any(scene.origin):
        raise OutputError("coordinates so far from zero do not fit into .spz; write a .ply")
    bits = max_exponent(scene) - exponent
    if bits < 0:
        raise OutputError(
            f"coordinates up to {np.abs(scene.means).max() * 2.0**exponent:.3g} do not fit into "
            f".spz, which holds up to {_MAX_COORDINATE}"
        )
    bits = min(bits, _MAX_FRACTIONAL_BITS)
    lowest, highest = _LOG_SCALES
    largest = np.log(scene.scales.max(axis=1).astype(np.float64)) + exponent * math.log(2.0)
    if largest.max() > highest + 1 / 32:
        raise OutputError(
            f"scales up to {np.exp(largest.max()):.3g} do not fit into .spz, which holds up to "
            f"{math.exp(highest):.0f}"
        )
    specks = int(np.count_nonzero(largest < lowest - 1 / 32))
    if specks > _MAX_SPECK_SHARE * len(scene):
        raise OutputError(
            f"{specks} of {len(scene)} Gaussians are smaller than {math.exp(lowest):.2g}, the "
            "smallest size that .spz holds"
        )
    shift = exponent + bits - _WRITTEN_FRACTIONAL_BITS
    written = from_ply(ply_bytes(scene, means_exponent=shift, scales_exponent=exponent), "spz")
    return _completed(written, bits, scene)


def max_exponent(scene: GaussianScene) -> int:
    """The largest power of two by which coordinates may be multiplied to fit 24 bits."""
    largest = float(np.abs(scene.means).max())
    if largest == 0.0:
        return _MAX_FRACTIONAL_BITS
    exponent = 23 - math.frexp(largest)[1]
    return exponent if largest * 2.0**exponent <= _MAX_COORDINATE else exponent - 1


def best_exponent(scene: GaussianScene) -> int:
    """The power of two for :func:`encode_spz` that brings the largest scale to the end of the
    format's range, so that the smallest ones keep the most room."""
    largest = math.log(float(scene.scales.max()))
    exponent = math.floor((_LOG_SCALES[1] - largest) / math.log(2.0))
    return max(-100, min(exponent, max_exponent(scene), 100))  # a factor that float32 holds


def _completed(data: bytes, fractional_bits: int, scene: GaussianScene) -> bytes:
    """What gaussforge wrote, with what it leaves out or rounds too much."""
    content = bytearray(gzip.decompress(data))
    magic, version, count, degree, bits, _, _ = _HEADER.unpack_from(content)
    expected = (b"NGSP", 3, len(scene), scene.sh_degree, _WRITTEN_FRACTIONAL_BITS)
    if (magic, version, count, degree, bits) != expected:
        raise OutputError(
            "this gaussforge writes a kind of .spz that gscpe does not know; write a .ply, or "
            "install gaussforge 0.6"
        )
    header = (magic, version, count, degree, fractional_bits, int(scene.antialiased), 0)
    _HEADER.pack_into(content, 0, *header)
    harmonics = np.clip(2.0 * np.rint(64.0 * scene.sh[:, 1:]) + 128.0, 0, 254).astype(np.uint8)
    content[len(content) - harmonics.size :] = harmonics.tobytes()
    return gzip.compress(content, compresslevel=6, mtime=0)
