# SPDX-License-Identifier: Apache-2.0
"""Lengths of things that photos show, as people write them down."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Mapping

import numpy as np

from gscpe.errors import SettingsError
from gscpe.given import reading_failed

_FORM = (
    "a line NAME,PHOTO,X,Y says where a photo shows a point, and a line NAME,NAME,METRES how far "
    "apart two points are"
)


@dataclass(frozen=True)
class KnownLengths:
    """What a file of points says; see :func:`gscpe.read_lengths`.

    Attributes:
        seen: by the point's name, by the photo's: pixel x, y.
        metres: between two points.
    """

    seen: Mapping[str, Mapping[str, tuple[float, float]]]
    metres: Mapping[tuple[str, str], float]


def read_lengths(path: Path) -> KnownLengths:
    """A text file, comma-separated: ``NAME,PHOTO,X,Y`` says where a photo shows a point, and
    ``NAME,NAME,METRES`` how far apart two points are. Each point is in at least two photos. Names
    with commas stand in double quotes; lines that begin with # do not count.

    Raises:
        SettingsError: it is not of this form, or a point is in fewer than two photos.
    """
    seen: dict[str, dict[str, tuple[float, float]]] = {}
    metres: dict[tuple[str, str], float] = {}
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise SettingsError(f"{path} cannot be read: {reading_failed(error)}") from error
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        fields = [field.strip() for field in next(csv.reader([line], skipinitialspace=True))]
        try:
            if len(fields) == 4 and all(fields):
                pixel = float(fields[2]), float(fields[3])
                if not np.all(np.isfinite(pixel)) or fields[1] in seen.get(fields[0], {}):
                    raise ValueError
                seen.setdefault(fields[0], {})[fields[1]] = pixel
            elif len(fields) == 3 and fields[0] != fields[1] and 0 < float(fields[2]) < np.inf:
                metres[fields[0], fields[1]] = float(fields[2])
            else:
                raise ValueError
        except ValueError:
            raise SettingsError(f"{path}, line {number}: {line.strip()!r}; {_FORM}") from None
    if not metres:
        raise SettingsError(f"{path} has no length: {_FORM}")
    for name in (name for pair in metres for name in pair):
        if len(seen.get(name, {})) < 2:
            raise SettingsError(
                f"{path}: point {name!r} is shown in {len(seen.get(name, {}))} photos, and at "
                f"least 2 are needed; {_FORM}"
            )
    return KnownLengths(seen, metres)
