# SPDX-License-Identifier: Apache-2.0
"""Point matches between a photo and a render, behind one protocol."""

from gscpe.matching.choose import MATCHERS, make_matcher, matcher_name, name_of
from gscpe.matching.lighterglue_matcher import LighterGlueMatcher, LighterGlueMatcherSettings
from gscpe.matching.onnx_matcher import OnnxMatcher, OnnxMatcherSettings
from gscpe.matching.polish import PolishSettings
from gscpe.matching.protocol import Matcher, Matches
from gscpe.matching.sift_matcher import SiftMatcher, SiftMatcherSettings
from gscpe.matching.xfeat_matcher import XFeatMatcher, XFeatMatcherSettings

__all__ = [
    "MATCHERS",
    "LighterGlueMatcher",
    "LighterGlueMatcherSettings",
    "Matcher",
    "Matches",
    "OnnxMatcher",
    "OnnxMatcherSettings",
    "PolishSettings",
    "SiftMatcher",
    "SiftMatcherSettings",
    "XFeatMatcher",
    "XFeatMatcherSettings",
    "make_matcher",
    "matcher_name",
    "name_of",
]
