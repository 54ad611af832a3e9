"""Which reference photos look like the query: global descriptors and their comparison."""

from gscpe.retrieval.search import RetrievedReference, search
from gscpe.retrieval.vlad import VladSettings, describe_image, learn_vocabulary, local_descriptors

__all__ = [
    "RetrievedReference",
    "VladSettings",
    "describe_image",
    "learn_vocabulary",
    "local_descriptors",
    "search",
]
