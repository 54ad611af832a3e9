# SPDX-License-Identifier: Apache-2.0
"""Every field of every settings class, with values that it cannot have: each must be refused where
it is given, and the message must name it."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import math
import pkgutil
import types
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import pytest

import gscpe
from gscpe.errors import SettingsError

NO_SETTINGS = {
    "Findings": "what is to be shown",
    "MapFrame": "raises MapError: a part of a map, not a setting",
    "OpenGLFacts": "what was found out",
    "ScaleSource": "made by ScaleSource.parse, which checks the text that it is given",
    "Stop": "a message",
}
"""Frozen dataclasses that can be made without arguments, but are no settings."""

BELOW_ZERO = {
    "FrameCheckSettings.min_correlation": "a correlation",
    "TrustSettings.min_agreement": "a correlation",
    "TrustSettings.sure_agreement": "a correlation",
    "VerificationSettings.min_agreement": "a correlation",
    "VerificationSettings.min_tracking_agreement": "a correlation",
    "VerificationSettings.sure_agreement": "a correlation",
    "VerificationSettings.decisive_agreement": "a correlation",
    "VerificationSettings.changed_agreement": "a correlation",
    "ViewpointSettings.pitch_down": "an angle: below 0, views look up",
    "XFeatMatcherSettings.min_cosine": "a cosine",
}
"""Numbers that may be negative."""


def settings_classes() -> list[type[Any]]:
    found: dict[str, type[Any]] = {}
    for module in pkgutil.walk_packages(gscpe.__path__, "gscpe."):
        if module.name.endswith("__main__"):
            continue
        for name, value in vars(importlib.import_module(module.name)).items():
            if not inspect.isclass(value) or not dataclasses.is_dataclass(value):
                continue
            frozen = value.__dataclass_params__.frozen  # type: ignore[attr-defined]
            if not frozen or name in NO_SETTINGS:
                continue
            if all(_has_default(field) for field in dataclasses.fields(value)):
                found[name] = value
    return [found[name] for name in sorted(found)]


def _has_default(field: dataclasses.Field[Any]) -> bool:
    missing = dataclasses.MISSING
    return field.default is not missing or field.default_factory is not missing


def wrong_values(name: str, kind: Any) -> list[Any]:
    """Values that a field of this name and annotation must refuse."""
    kinds = get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)
    wrong: list[Any] = [object(), b"1", [1], math.nan]
    if type(None) not in kinds:
        wrong.append(None)
    if str not in kinds and get_origin(kind) is not Literal:
        wrong.append("1")
    if bool not in kinds:
        wrong.append(True)
    if int in kinds:
        wrong += [-1, 0.5, 10.0, math.inf]
    elif float in kinds:
        wrong += [-math.inf] if name in BELOW_ZERO else [-1e-9, -1]
    else:
        wrong += [1, -1, 0.5]
    if any(get_origin(one) is tuple for one in kinds):
        wrong += [(math.nan,) * 3, ("a", "b", "c"), (1e300,) * 3, ("1",)]
    return wrong


FIELDS = [
    pytest.param(settings, field.name, get_type_hints(settings)[field.name], id=name)
    for settings in settings_classes()
    for field in dataclasses.fields(settings)
    for name in [f"{settings.__name__}.{field.name}"]
]


@pytest.mark.parametrize(("settings", "field", "kind"), FIELDS)
def test_impossible_values_are_refused(settings: type[Any], field: str, kind: Any) -> None:
    for value in wrong_values(f"{settings.__name__}.{field}", kind):
        with pytest.raises(SettingsError) as caught:
            settings(**{field: value})
        if field != "retrieval":
            assert field in str(caught.value), value
        assert len(str(caught.value)) < 250


def test_the_lists_of_exceptions_hold_no_more_than_there_is() -> None:
    names = {f"{settings.__name__}.{f.name}" for settings, f in _all_fields()}
    assert set(BELOW_ZERO) <= names
    assert len(settings_classes()) > 30


def _all_fields() -> list[tuple[type[Any], dataclasses.Field[Any]]]:
    return [(one, field) for one in settings_classes() for field in dataclasses.fields(one)]


@pytest.mark.parametrize("settings", settings_classes())
def test_defaults_are_allowed(settings: type[Any]) -> None:
    settings()
