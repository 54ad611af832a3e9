"""Point matches between a photo and a render, behind one protocol."""

from gscpe.matching.protocol import Matcher, Matches
from gscpe.matching.sift_matcher import SiftMatcher, SiftMatcherSettings

__all__ = ["Matcher", "Matches", "SiftMatcher", "SiftMatcherSettings"]
