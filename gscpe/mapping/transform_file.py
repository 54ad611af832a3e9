# SPDX-License-Identifier: Apache-2.0
"""Files that say what was done to a scene before its splat was trained or exported."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gscpe.errors import InputError, PoseError, SettingsError
from gscpe.geometry.similarity_transform import Similarity
from gscpe.given import parse_json, reading_failed


def read_transform(path: str | Path) -> Similarity:
    """The similarity ``splat_from_model`` of a file.

    Either nerfstudio's ``dataparser_transforms.json``: a 3x4 ``transform`` of the model's points,
    and a ``scale`` that is applied after it, ``x_splat = scale * (transform @ (x_model, 1))``. Or
    a text or ``.json`` file with a 3x4 or 4x4 matrix of numbers, row by row.

    Raises:
        SettingsError: the file is missing, or holds something else.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"transform {path} cannot be read: {reading_failed(error)}") from error
    try:
        return _parse(text)
    except (ValueError, TypeError, KeyError, InputError) as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise SettingsError(
            f"transform {path} is neither nerfstudio's dataparser_transforms.json nor a 3x4 or "
            f"4x4 matrix: {reason}"
        ) from error


def _parse(text: str) -> Similarity:
    if text.lstrip()[:1] not in ("{", "["):
        rows = [line.split("#")[0].replace(",", " ").split() for line in text.splitlines()]
        return Similarity.of_matrix([[float(word) for word in row] for row in rows if row])
    data = parse_json(text)
    if isinstance(data, list):
        return Similarity.of_matrix(data)
    rigid = Similarity.of_matrix(data["transform"])
    scale = float(data.get("scale", 1.0))
    if not 0 < scale < np.inf:
        raise PoseError(f"the scale must be positive, not {scale}")
    return Similarity(scale * rigid.scale, rigid.rotation, scale * rigid.translation)
