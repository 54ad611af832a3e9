# SPDX-License-Identifier: Apache-2.0
"""The matcher of a localizer, and those that are tried after it."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.errors import MissingDependencyError, ModelError
from gscpe.matching import Matcher, make_matcher, matcher_name, name_of

_ORDER = ("xfeat", "xfeat+lighterglue", "sift")
"""From cheap to costly."""


@dataclass(frozen=True, eq=False)
class NamedMatcher:
    """A matcher and its name."""

    name: str
    matcher: Matcher


class Matchers:
    """Opens matchers when they are needed.

    Args:
        matcher: a matcher, which is used alone; or the name of one, or None for "auto", which is
            followed by those that cost more.
        followed: whether others follow at all.

    Raises:
        SettingsError, ModelError, MissingDependencyError: of :func:`gscpe.make_matcher`.
    """

    def __init__(self, matcher: Matcher | str | None, followed: bool = True) -> None:
        self._opened: dict[str, NamedMatcher | str] = {}
        if matcher is None or isinstance(matcher, str):
            name = matcher_name("auto" if matcher is None else matcher)
            self.first = NamedMatcher(name, make_matcher(name))
        else:
            self.first, followed = NamedMatcher(name_of(matcher), matcher), False
        known = followed and self.first.name in _ORDER
        self.others = _ORDER[_ORDER.index(self.first.name) + 1 :] if known else ()

    def open(self, name: str) -> NamedMatcher | str:
        """The matcher of this name; a string says why it cannot be used."""
        if name not in self._opened:
            try:
                self._opened[name] = NamedMatcher(name, make_matcher(name))
            except (ModelError, MissingDependencyError) as error:
                self._opened[name] = str(error)
        return self._opened[name]
