# SPDX-License-Identifier: Apache-2.0
"""What tests of splat files check of what was read, or was not."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from gscpe.errors import SplatError
from gscpe.splats import GaussianScene, read_splat

ENCODINGS = ("binary_little_endian", "binary_big_endian", "ascii")


def assert_refused(path: Path, *words: str) -> None:
    """It must be a SplatError, name the file, and say these words."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SplatError) as caught:
            read_splat(path)
    for word in (str(path), *words):
        assert word in str(caught.value)


def assert_valid(scene: GaussianScene) -> None:
    """The bounds that GaussianScene documents."""
    for name in ("means", "quaternions", "scales", "opacities", "sh"):
        array = getattr(scene, name)
        assert array.dtype == np.float32
        assert len(array) == len(scene) > 0
        assert np.all(np.isfinite(array)), name
    lengths = np.linalg.norm(scene.quaternions.astype(np.float64), axis=1)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-5)
    assert np.all(scene.scales > 0)
    assert np.all((scene.opacities >= 0) & (scene.opacities <= 1))
