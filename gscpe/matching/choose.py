# SPDX-License-Identifier: Apache-2.0
"""Matchers by name."""

from __future__ import annotations

import logging
from pathlib import Path

from gscpe.errors import ModelError, SettingsError
from gscpe.matching.lighterglue_matcher import LighterGlueMatcher
from gscpe.matching.onnx_matcher import OnnxMatcher
from gscpe.matching.protocol import Matcher
from gscpe.matching.sift_matcher import SiftMatcher
from gscpe.matching.xfeat_matcher import XFeatMatcher
from gscpe.models import installed_files

_log = logging.getLogger(__name__)

ONNX = "onnx:"
MATCHERS = ("auto", "sift", "xfeat", "xfeat+lighterglue", f"{ONNX}PATH")
"""Names that :func:`make_matcher` knows."""


def make_matcher(name: str = "auto") -> Matcher:
    """The matcher of this name.

    ``auto`` is ``xfeat`` where that is installed, else ``sift``; the log says which.
    ``onnx:PATH`` is any exported matcher, see :class:`gscpe.matching.OnnxMatcher`.

    Raises:
        SettingsError: there is no matcher of this name.
        ModelError: its networks are not installed, damaged, or not of the expected form.
        MissingDependencyError: onnxruntime is not installed.
    """
    name = matcher_name(name)
    _log.info("photos and renders are matched by %s", name)
    if name == "sift":
        return SiftMatcher()
    if name == "xfeat":
        _refuse_damaged("xfeat.onnx")
        return XFeatMatcher()
    if name == "xfeat+lighterglue":
        _refuse_damaged("xfeat.onnx")
        _refuse_damaged("lighterglue.onnx")
        return LighterGlueMatcher()
    if name.startswith(ONNX) and len(name) > len(ONNX):
        return OnnxMatcher(Path(name.removeprefix(ONNX)))
    raise SettingsError(f"there is no matcher {name!r}; choose one of {', '.join(MATCHERS)}")


def matcher_name(name: str) -> str:
    """What ``auto`` stands for on this machine; other names as they are."""
    if name != "auto":
        return name
    return "sift" if _state("xfeat.onnx") == "missing" else "xfeat"


def _state(network: str) -> str:
    """As :class:`gscpe.models.InstalledFile` has it."""
    return next(file.state for file in installed_files("xfeat") if file.path.name == network)


def _refuse_damaged(network: str) -> None:
    """A network that is missing has an error of its own when it is opened."""
    state = _state(network)
    if state not in ("ok", "missing"):
        raise ModelError(
            f"{network} is {state}; install it again (gscpe models install xfeat), "
            "or choose the matcher sift"
        )


def name_of(matcher: Matcher) -> str:
    """The name of a matcher; of a kind that has none, its class's."""
    names = {
        SiftMatcher: "sift",
        XFeatMatcher: "xfeat",
        LighterGlueMatcher: "xfeat+lighterglue",
        OnnxMatcher: "onnx",
    }
    return names.get(type(matcher), type(matcher).__name__)
