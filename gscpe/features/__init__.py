"""Local features of an image, which retrieval and matching share."""

from gscpe.features.sift import LocalFeatures, SiftSettings, extract_sift

__all__ = ["LocalFeatures", "SiftSettings", "extract_sift"]
