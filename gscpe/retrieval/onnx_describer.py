# SPDX-License-Identifier: Apache-2.0
"""A global descriptor that was exported to ONNX, such as NetVLAD, EigenPlaces or MegaLoc.

``NAME.onnx`` has the input "image", (1, 3, H, W) float32 RGB, and as its first output the
descriptor, (1, D) float32. ``NAME.json`` beside it says how an image is put into it; see
docs/formats.md.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array
from gscpe.errors import ModelError
from gscpe.features.xfeat import XFeatFeatures
from gscpe.given import parse_json
from gscpe.models import open_session
from gscpe.scene import DescriberModel

_FLOAT = "tensor(float)"
_RESIZE = ("stretch", "crop")


@dataclass(frozen=True)
class OnnxInput:
    """How an image is put into a network.

    Attributes:
        size: width and height in pixels.
        mean, std: a channel, of values in [0, 1]: the network sees ``(value - mean) / std``.
        resize: "stretch" to the size, or "crop" the middle after its shorter side fits.
    """

    size: tuple[int, int]
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    resize: str = "stretch"

    def tensor(self, rgb: UInt8Array) -> Float32Array:
        """(1, 3, H, W) float32 of an (H', W', 3) uint8 image."""
        width, height = self.size
        if self.resize == "crop":
            rgb = _cropped(rgb, width / height)
        shrinks = rgb.shape[0] > height or rgb.shape[1] > width
        interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        resized = cv2.resize(rgb, (width, height), interpolation=interpolation)
        values = (resized / 255.0 - np.array(self.mean)) / np.array(self.std)
        return np.ascontiguousarray(values.transpose(2, 0, 1)[None], dtype=np.float32)


class OnnxDescriber:
    """Implements :class:`gscpe.retrieval.GlobalDescriber`."""

    def __init__(self, path: str | Path, threads: int | None = None) -> None:
        """Opens ``path``, an ``.onnx`` file with its ``.json`` beside it.

        Raises:
            ModelError: a file is missing, damaged, needs a newer onnxruntime, or is of another
                form than the module's description says.
            MissingDependencyError: onnxruntime is not installed.
        """
        self._path = Path(path)
        self._input = read_onnx_input(self._path)
        self._session = open_session(self._path, threads)
        self._output = _check_form(self._session, self._path, self._input)

    def describe(
        self, rgb: UInt8Array, local: XFeatFeatures | None = None, valid: BoolArray | None = None
    ) -> Float32Array:
        try:
            (output,) = self._session.run([self._output], {"image": self._input.tensor(rgb)})
        except Exception as error:  # onnxruntime's errors have no common class
            raise ModelError(f"{self._path} cannot be run: {error}") from error
        if not isinstance(output, np.ndarray) or output.ndim != 2 or output.shape[0] != 1:
            shape = getattr(output, "shape", type(output).__name__)
            raise ModelError(f"{self._path}: output {self._output} is {shape} instead of (1, D)")
        if not np.all(np.isfinite(output)):
            raise ModelError(
                f"{self._path}: output {self._output} holds values that are not finite; is the "
                f"file whole, and does {self._path.stem}.json fit it?"
            )
        descriptor = output[0].astype(np.float64)
        length = float(np.linalg.norm(descriptor))
        return np.asarray(descriptor / max(length, 1e-12), dtype=np.float32)

    def record(self) -> DescriberModel:
        """What a map keeps to know this network again."""
        return describe_model(self._path, self._input)


def describe_model(path: Path, settings: OnnxInput) -> DescriberModel:
    """Name, checksum and input of a network. Weights beside it (``NAME.onnx.data``, as PyTorch
    writes them) belong to the checksum.

    Raises:
        ModelError: it cannot be read.
    """
    digest = hashlib.sha256()
    weights = path.with_name(f"{path.name}.data")
    try:
        for part in (path, weights) if weights.is_file() else (path,):
            with part.open("rb") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {error.strerror}") from error
    return DescriberModel(path.name, digest.hexdigest(), json.dumps(asdict(settings)))


def read_onnx_input(path: Path) -> OnnxInput:
    """Reads the ``.json`` beside an ``.onnx`` file.

    Raises:
        ModelError: either is missing, or the ``.json`` does not hold what it must.
    """
    if not path.is_file():
        raise ModelError(f"{path} is missing; give a global descriptor network exported to ONNX")
    beside = path.with_suffix(".json")
    try:
        data = parse_json(beside.read_bytes())
    except FileNotFoundError as error:
        raise ModelError(
            f"{beside} is missing; it describes the input of {path.name}: size, mean, std"
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise ModelError(f"{beside} is not readable JSON ({error})") from error
    try:
        return _parse(data)
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise ModelError(
            f'{beside} must look like {{"size": [width, height], "mean": [r, g, b], '
            f'"std": [r, g, b], "resize": "stretch" or "crop"}} ({error})'
        ) from error


def _parse(data: Any) -> OnnxInput:
    if not isinstance(data, dict):
        raise ValueError("it is not an object")
    if unknown := set(data) - {"size", "mean", "std", "resize"}:
        raise ValueError(f"{', '.join(sorted(unknown))} is unknown")
    if missing := {"size", "mean", "std"} - set(data):
        raise ValueError(f"{', '.join(sorted(missing))} is missing")
    width, height = data["size"]
    if not all(type(each) is int and 1 <= each <= 8192 for each in (width, height)):
        raise ValueError(f"size is {data['size']}")
    channels = {}
    for name in ("mean", "std"):
        red, green, blue = (float(each) for each in data[name])
        channels[name] = (red, green, blue)
        if not np.all(np.isfinite(channels[name])):
            raise ValueError(f"{name} is {data[name]}")
    if min(channels["std"]) <= 0:
        raise ValueError(f"std is {data['std']}")
    resize = data.get("resize", "stretch")
    if resize not in _RESIZE:
        raise ValueError(f"resize is {resize!r}")
    return OnnxInput((width, height), channels["mean"], channels["std"], resize)


def _check_form(session: Any, path: Path, settings: OnnxInput) -> str:
    """The first output's name."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if [each.name for each in inputs] != ["image"]:
        names = ", ".join(each.name for each in inputs)
        raise ModelError(f'{path} must have one input, "image"; it has: {names}')
    width, height = settings.size
    image, output = inputs[0], outputs[0]
    if image.type != _FLOAT or not _allows(image.shape, (1, 3, height, width)):
        raise ModelError(
            f"{path}: image is a {image.type} of shape {image.shape}, which does not take the "
            f"{_FLOAT} of shape (1, 3, {height}, {width}) that {path.stem}.json makes"
        )
    if output.type != _FLOAT or not _allows(output.shape, (1, None)):
        raise ModelError(
            f"{path}: its first output, {output.name}, is a {output.type} of shape "
            f"{output.shape} instead of a {_FLOAT} of shape (1, D)"
        )
    return str(output.name)


def _allows(found: list[int | str | None], shape: tuple[int | None, ...]) -> bool:
    """Lengths that the file leaves open may be any; onnxruntime gives [] for an unknown rank."""
    return not found or (
        len(found) == len(shape)
        and all(
            wanted is None or not isinstance(length, int) or length == wanted
            for length, wanted in zip(found, shape, strict=True)
        )
    )


def _cropped(rgb: UInt8Array, aspect: float) -> UInt8Array:
    """The largest middle part of this aspect (width / height)."""
    height, width = rgb.shape[:2]
    columns = max(1, min(width, round(height * aspect)))
    rows = max(1, min(height, round(width / aspect)))
    top, left = (height - rows) // 2, (width - columns) // 2
    return rgb[top : top + rows, left : left + columns]
