# SPDX-License-Identifier: Apache-2.0
"""Which reference photos look like the query: global descriptors and their comparison."""

from gscpe.retrieval.methods import (
    METHODS,
    check_method,
    describe_references,
    descriptors_folder,
    open_describer,
    parse_method,
)
from gscpe.retrieval.onnx_describer import OnnxDescriber, OnnxInput
from gscpe.retrieval.protocol import GlobalDescriber
from gscpe.retrieval.search import IndexSettings, ReferenceIndex, RetrievedReference, search
from gscpe.retrieval.vlad import VocabularySettings, aggregate, learn_vocabulary
from gscpe.retrieval.vlad_describer import VladDescriber, rootsift, xfeat

__all__ = [
    "METHODS",
    "GlobalDescriber",
    "IndexSettings",
    "OnnxDescriber",
    "OnnxInput",
    "ReferenceIndex",
    "RetrievedReference",
    "VladDescriber",
    "VocabularySettings",
    "aggregate",
    "check_method",
    "describe_references",
    "descriptors_folder",
    "learn_vocabulary",
    "open_describer",
    "parse_method",
    "rootsift",
    "search",
    "xfeat",
]
