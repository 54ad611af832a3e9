# SPDX-License-Identifier: Apache-2.0
"""Where a photo was taken, as its camera's satellite receiver had it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.photos.exif import exif_of

_GPS_BLOCK = 0x8825
_LATITUDE_SIDE, _LATITUDE, _LONGITUDE_SIDE, _LONGITUDE, _BELOW, _ALTITUDE = range(1, 7)
_EQUATOR, _FLATTENING = 6_378_137.0, 1 / 298.257223563  # WGS 84


def gps_from_exif(path: str | Path) -> tuple[float, float, float] | None:
    """Latitude and longitude in degrees, altitude in metres (0 where the file does not say); None
    where it has no position.

    Raises:
        PhotoError: the file is missing or is not an image.
    """
    block = exif_of(Path(path)).get_ifd(_GPS_BLOCK)
    try:
        latitude = _degrees(block[_LATITUDE]) * (-1 if block[_LATITUDE_SIDE] == "S" else 1)
        longitude = _degrees(block[_LONGITUDE]) * (-1 if block[_LONGITUDE_SIDE] == "W" else 1)
        altitude = float(block.get(_ALTITUDE, 0.0))
        below = block.get(_BELOW, 0) in (1, b"\x01")
    except (KeyError, TypeError, ValueError, ZeroDivisionError, IndexError):
        return None
    position = latitude, longitude, -altitude if below else altitude
    if not np.all(np.isfinite(position)) or abs(latitude) > 90 or abs(longitude) > 180:
        return None
    return position if latitude or longitude else None  # 0, 0 is what no fix looks like


def local_metres(positions: Float64Array, origin: Float64Array) -> Float64Array:
    """East, north and up, (N, 3), metres from ``origin``, of latitudes, longitudes and altitudes,
    (N, 3), within some kilometres: on the plane that touches the ellipsoid there."""
    latitude = np.radians(origin[0])
    squared = _FLATTENING * (2 - _FLATTENING)
    w = np.sqrt(1 - squared * np.sin(latitude) ** 2)
    across, along = _EQUATOR / w, _EQUATOR * (1 - squared) / w**3
    offset = positions - origin
    turned = (np.radians(offset[:, 1]) + np.pi) % (2 * np.pi) - np.pi
    return np.stack(
        [turned * across * np.cos(latitude), np.radians(offset[:, 0]) * along, offset[:, 2]], axis=1
    )


def _degrees(parts: tuple[float, float, float]) -> float:
    degrees, minutes, seconds = (float(part) for part in parts)
    return degrees + minutes / 60 + seconds / 3600
