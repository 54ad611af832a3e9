# SPDX-License-Identifier: Apache-2.0
"""Names for the array types that travel between the rooms, and how what holds arrays prints."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Float64Array: TypeAlias = NDArray[np.float64]
Float32Array: TypeAlias = NDArray[np.float32]
UInt8Array: TypeAlias = NDArray[np.uint8]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.intp]

_SHOWN = 60


def short_repr(instance: DataclassInstance) -> str:
    """A dataclass on one line, for its ``__repr__``: of arrays type and shape, of long
    collections only how much is in them."""
    parts = (f"{field.name}={_short(getattr(instance, field.name))}" for field in fields(instance))
    return f"{type(instance).__name__}({', '.join(parts)})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} {'x'.join(map(str, value.shape)) or 'scalar'}>"
    if isinstance(value, float):
        return f"{value:.6g}"
    text = repr(value)
    if len(text) > _SHOWN and isinstance(value, tuple | list | dict | str | bytes):
        return f"<{type(value).__name__} of {len(value)}>"
    return text
