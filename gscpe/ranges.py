# SPDX-License-Identifier: Apache-2.0
"""Whether settings hold what they should. A value that nothing checks does harm far from where
it was given: a comparison with NaN is always false, so that a limit of NaN is none."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import Any

from gscpe.errors import SettingsError


def check_whole(
    settings: object, *names: str, least: int, most: int | None = None, optional: bool = False
) -> None:
    """Refuses attributes that are no whole numbers from ``least`` to ``most``.

    Args:
        settings: whose attributes they are; its class is named in the message.
        names: of the attributes.
        least, most: bounds, which are allowed themselves.
        optional: None is allowed, too.

    Raises:
        SettingsError: one is something else.
    """
    bounds = f"{least} or more" if most is None else f"{least} to {most}"
    for name, value in _given(settings, names, optional):
        right = isinstance(value, Integral) and not isinstance(value, bool)
        if not right or value < least or (most is not None and value > most):
            _refuse(settings, name, f"a whole number, {bounds}", value, optional)


def check_numbers(
    settings: object,
    *names: str,
    least: float | None = None,
    above: float | None = None,
    most: float | None = None,
    below: float | None = None,
    infinite: bool = False,
    optional: bool = False,
) -> None:
    """Refuses attributes that are no numbers, are NaN, or lie outside of the bounds.

    Args:
        settings: whose attributes they are; its class is named in the message.
        names: of the attributes.
        least, most: bounds that are allowed themselves.
        above, below: bounds that are not.
        infinite: infinity is allowed, within the bounds: a limit that nothing exceeds.
        optional: None is allowed, too.

    Raises:
        SettingsError: one is something else.
    """
    words = ("at least", least), ("more than", above), ("at most", most), ("less than", below)
    bounds = [f"{word} {bound:g}" for word, bound in words if bound is not None]
    wanted = " and ".join(bounds)
    for name, value in _given(settings, names, optional):
        right = isinstance(value, Real) and not isinstance(value, bool)
        if not right or not _lies_within(float(value), least, above, most, below, infinite):
            kind = "a number" if infinite else "a finite number"
            _refuse(settings, name, f"{kind}, {wanted}" if wanted else kind, value, optional)


def check_shares(settings: object, *names: str) -> None:
    """Refuses attributes that do not lie in [0, 1].

    Raises:
        SettingsError: one does not.
    """
    check_numbers(settings, *names, least=0, most=1)


def check_kinds(settings: object, **kinds: type | tuple[type, ...]) -> None:
    """Refuses attributes that are not of these classes, given by the attributes' names.

    Raises:
        SettingsError: one is of another class.
    """
    for name, kind in kinds.items():
        value = getattr(settings, name)
        if not isinstance(value, kind):
            alternatives = kind if isinstance(kind, tuple) else (kind,)
            wanted = " or ".join(_KINDS.get(one, one.__name__) for one in alternatives)
            _refuse(settings, name, wanted, value, optional=False)


def check_test_every(test_every: int) -> None:
    """Of photos whose every so many-th is left out for a test.

    Raises:
        SettingsError: it is neither 0 nor a whole number of 2 and more.
    """
    whole = isinstance(test_every, Integral) and not isinstance(test_every, bool)
    if not whole or test_every < 0 or test_every == 1:
        raise SettingsError(f"test_every must be 0, or 2 and more, not {test_every!r}")


_KINDS = {bool: "True or False", str: "text", type(None): "None"}


def _given(settings: object, names: tuple[str, ...], optional: bool) -> list[tuple[str, Any]]:
    values = [(name, getattr(settings, name)) for name in names]
    return [(name, value) for name, value in values if value is not None or not optional]


def _lies_within(
    value: float,
    least: float | None,
    above: float | None,
    most: float | None,
    below: float | None,
    infinite: bool,
) -> bool:
    return (
        not math.isnan(value)
        and (infinite or math.isfinite(value))
        and (least is None or value >= least)
        and (above is None or value > above)
        and (most is None or value <= most)
        and (below is None or value < below)
    )


def _refuse(settings: object, name: str, wanted: str, value: object, optional: bool) -> None:
    alternative = "None or " if optional else ""
    raise SettingsError(
        f"{type(settings).__name__}.{name} must be {alternative}{wanted}, not {_shown(value)}"
    )


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"a {type(value).__name__}"
