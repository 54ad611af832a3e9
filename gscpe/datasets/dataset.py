# SPDX-License-Identifier: Apache-2.0
"""What every data set comes down to: references, queries, and one or more ground truths."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Mapping

from gscpe.arrays import Float64Array, short_repr
from gscpe.errors import DatasetError
from gscpe.scene import References
from gscpe.scene.query_list import Query

OFFICIAL = "official"
"""The split that papers use."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """One scene of a data set, split into references (train) and queries (test).

    Attributes:
        name: of the data set, as tables print it, for example "7-Scenes".
        scene: of the scene, for example "redkitchen".
        references: photos with known poses; names are relative to ``image_folder``.
        queries: photos to localize, and their cameras.
        image_folder: that holds both, unless the queries have a folder of their own.
        truths: name of a ground truth -> photo name -> ``cam_from_world``, (4, 4) float64. The
            first is the one that the references' poses are of.
        metres_per_unit: of the poses; None where it is not known.
        query_folder: that the queries' names are relative to; None: the image folder.
        split: how references and queries were separated, as text; OFFICIAL where it is that of the
            data set, and complete, so that published numbers may be compared.

    Raises:
        DatasetError: there are no references, no queries or no ground truth, or a query is a
            reference too.
    """

    name: str
    scene: str
    references: References
    queries: tuple[Query, ...]
    image_folder: Path
    truths: Mapping[str, Mapping[str, Float64Array]]
    metres_per_unit: float | None = 1.0
    query_folder: Path | None = None
    split: str = "chosen"

    def __post_init__(self) -> None:
        what = f"{self.name} {self.scene}"
        if not len(self.references):
            raise DatasetError(f"{what}: no reference photos are left; is the split right?")
        if not self.queries:
            raise DatasetError(f"{what}: no query photos are left; is the split right?")
        if not self.truths:
            raise DatasetError(f"{what}: no ground truth")
        if self.query_folder is not None and self.query_folder != self.image_folder:
            return
        both = {query.name for query in self.queries} & set(self.references.names)
        if both:
            raise DatasetError(f"{what}: {min(both)} is both a reference and a query")

    def __repr__(self) -> str:
        return short_repr(self)
