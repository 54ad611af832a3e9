# SPDX-License-Identifier: Apache-2.0
"""Local features of an image, which retrieval and matching share."""

from gscpe.features.sift import LocalFeatures, SiftSettings, extract_sift
from gscpe.features.xfeat import XFeat, XFeatFeatures

__all__ = ["LocalFeatures", "SiftSettings", "XFeat", "XFeatFeatures", "extract_sift"]
