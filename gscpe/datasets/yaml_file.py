# SPDX-License-Identifier: Apache-2.0
"""Calibrations in YAML, as FAST-LIVO2 and OpenCV write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

from gscpe.datasets.files import read_text
from gscpe.errors import DatasetError, MissingDependencyError


def read_yaml(path: Path, source: str) -> Mapping[str, Any]:
    """The mapping that a YAML file holds.

    Raises:
        DatasetError: the file is missing, not YAML, or holds no mapping.
        MissingDependencyError: PyYAML is not installed.
    """
    try:
        import yaml
    except ImportError as error:
        raise MissingDependencyError(
            "reading a calibration in YAML needs PyYAML: pip install 'gscpe[datasets]'"
        ) from error
    # OpenCV begins its files with %YAML:1.0, which is not a YAML directive.
    lines = [line for line in read_text(path, source).split("\n") if not line.startswith("%YAML")]
    try:
        values = yaml.safe_load("\n".join(lines))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path} is not a YAML file: {' '.join(str(error).split())}") from error
    if not isinstance(values, dict):
        raise DatasetError(f"{path} holds no 'key: value' lines; it comes from {source}")
    return values


def mapping_with(values: Mapping[str, Any], key: str) -> Mapping[str, Any] | None:
    """The outermost mapping that has a key: ROS 2 wraps all in ``/**: ros__parameters: ...``."""
    if key in values:
        return values
    inner = (mapping_with(v, key) for v in values.values() if isinstance(v, dict))
    return next((found for found in inner if found is not None), None)
