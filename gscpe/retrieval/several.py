# SPDX-License-Identifier: Apache-2.0
"""A photo described as the references of several maps were: local features are found once."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

from gscpe.arrays import BoolArray, Float32Array, UInt8Array
from gscpe.retrieval.methods import open_describer
from gscpe.retrieval.protocol import GlobalDescriber
from gscpe.retrieval.vlad import aggregate
from gscpe.retrieval.vlad_describer import LocalDescriptors, VladDescriber
from gscpe.scene import GlobalDescriptors


class SeveralDescribers:
    """Describes photos for maps with vocabularies of their own.

    Args:
        known: of each map.
        model: path of the exported network, where one described them.

    Raises:
        MapError, ModelError, MissingDependencyError: as :func:`gscpe.retrieval.open_describer`.
    """

    def __init__(self, known: Sequence[GlobalDescriptors], model: str | Path | None = None) -> None:
        self._local: dict[str, LocalDescriptors] = {}
        self._describers: list[tuple[str, GlobalDescriber]] = []
        for each in known:
            describer = open_describer(each, model)
            self._describers.append((each.method, describer))
            if isinstance(describer, VladDescriber):
                self._local.setdefault(each.method, describer.local_descriptors)

    def describe(self, rgb: UInt8Array, valid: BoolArray | None = None) -> list[Float32Array]:
        """A descriptor for each map, (D,) float32 of unit length, or zero.

        Args:
            rgb: (H, W, 3) uint8.
            valid: (H, W), where the image shows something; None: everywhere.

        Raises:
            ModelError: a trained network cannot be run.
        """
        found = {method: local(rgb, None, valid) for method, local in self._local.items()}
        return [
            aggregate(found[method], describer.vocabulary)
            if isinstance(describer, VladDescriber)
            else describer.describe(rgb, None, valid)
            for method, describer in self._describers
        ]
