# SPDX-License-Identifier: Apache-2.0
"""Any two-image matcher in an ONNX file, whose form docs/formats.md describes."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from types import NoneType
from typing import Any, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import BoolArray, Float32Array, Float64Array, UInt8Array
from gscpe.errors import ModelError, SettingsError
from gscpe.given import parse_json
from gscpe.matching.polish import PolishSettings, for_polishing, polish
from gscpe.matching.protocol import Matches
from gscpe.models import open_session
from gscpe.ranges import check_kinds, check_whole

_INPUTS = ("image0", "image1")
_OUTPUTS = {"points0": (None, 2), "points1": (None, 2), "scores": (None,)}
_FLOATS = ("tensor(float)", "tensor(double)", "tensor(float16)")
_SLACK = 1.0
"""Pixels that a point may lie outside; it is dropped. Farther out, the contract is broken."""


@dataclass(frozen=True)
class OnnxMatcherSettings:
    """What an ONNX file cannot say about itself.

    Attributes:
        top_left_pixel_centre: coordinates of the centre of the top-left pixel in the
            network's points: 0 (OpenCV's) or 0.5 (COLMAP's).
        multiple_of: width and height that the network can take, where it does not fix them.
        polish: None leaves the matches where the network put them.
    """

    top_left_pixel_centre: float = 0.0
    multiple_of: int = 1
    polish: PolishSettings | None = field(default_factory=PolishSettings)

    def __post_init__(self) -> None:
        if self.top_left_pixel_centre not in (0.0, 0.5):
            raise SettingsError(
                f"top_left_pixel_centre must be 0 or 0.5, not {self.top_left_pixel_centre!r}"
            )
        check_whole(self, "multiple_of", least=1)
        check_kinds(self, polish=(PolishSettings, NoneType))


@dataclass(frozen=True, eq=False)
class OnnxImage:
    """An image as the network takes it.

    Attributes:
        tensor: (1, C, H', W') float32 in [0, 1].
        scale: (2,), pixels of the image for one of the tensor, along x and y.
        size: width and height of the image in pixels.
        valid: (H, W), where there may be matches; None: everywhere.
        normalized: (H, W) uint8, what polishing needs; None: not to be polished.
    """

    tensor: Float32Array
    scale: Float64Array
    size: tuple[int, int]
    valid: BoolArray | None
    normalized: UInt8Array | None


class OnnxMatcher:
    """Implements :class:`gscpe.matching.Matcher`."""

    def __init__(
        self,
        path: str | Path,
        settings: OnnxMatcherSettings | None = None,
        threads: int | None = None,
    ) -> None:
        """Opens a network.

        Args:
            path: an ``.onnx`` file.
            settings: None: those of the ``.json`` file of the same name beside it, if any.
            threads: as :func:`gscpe.models.open_session`.

        Raises:
            ModelError: a file is missing, damaged, or not of the form of docs/formats.md.
            MissingDependencyError: onnxruntime is not installed.
        """
        self._path = Path(path)
        if not self._path.is_file():
            raise ModelError(f"{path} is missing, or no file; give the path of an ONNX file")
        self._settings = settings or _read_settings(self._path.with_suffix(".json"))
        self._session = open_session(path, threads)
        self._channels, self._fixed_size = self._check_inputs()
        self._check_outputs()

    def prepare(self, rgb: UInt8Array, valid: BoolArray | None) -> OnnxImage:
        height, width = rgb.shape[:2]
        pixels = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)[:, :, None] if self._channels == 1 else rgb
        fixed_width, fixed_height = self._fixed_size
        target = (fixed_width or width, fixed_height or height)
        pixels = _resized(pixels, target)
        multiple = self._settings.multiple_of
        right = 0 if fixed_width else -width % multiple
        down = 0 if fixed_height else -height % multiple
        pixels = np.pad(pixels, ((0, down), (0, right), (0, 0)), mode="edge")
        tensor = np.ascontiguousarray(pixels.transpose(2, 0, 1)[None], dtype=np.float32)
        return OnnxImage(
            tensor=tensor / np.float32(255),
            scale=np.array([width / target[0], height / target[1]]),
            size=(width, height),
            valid=valid,
            normalized=for_polishing(rgb, self._settings.polish),
        )

    def match(self, photo: OnnxImage, render: OnnxImage) -> Matches:
        """Matches between two prepared images.

        Raises:
            ModelError: the network cannot be run, or what it gives breaks the contract.
        """
        points0, points1, scores = self._run(photo.tensor, render.tensor)
        photo_pixels = self._to_image(points0, photo, "points0")
        render_pixels = self._to_image(points1, render, "points1")
        kept = _usable(photo_pixels, photo) & _usable(render_pixels, render)
        photo_pixels, render_pixels = photo_pixels[kept], render_pixels[kept]
        render_pixels = polish(
            photo.normalized, render.normalized, photo_pixels, render_pixels, self._settings.polish
        )
        return Matches(photo_pixels, render_pixels, scores[kept].astype(np.float32))

    def _run(self, image0: Float32Array, image1: Float32Array) -> list[Float64Array]:
        """Points and scores in float64, their shapes and values checked."""
        try:
            outputs: Sequence[NDArray[Any]] = self._session.run(
                list(_OUTPUTS), {"image0": image0, "image1": image1}
            )
        except Exception as error:  # onnxruntime's errors have no common class
            raise ModelError(
                f"{self._path} cannot be run on images of {image0.shape} and {image1.shape}; "
                f"does it need sizes that are multiples (multiple_of in its .json)? {error}"
            ) from error
        named = dict(zip(_OUTPUTS, outputs, strict=True))
        shapes = ", ".join(f"{name} {output.shape}" for name, output in named.items())
        count = outputs[-1].size
        if [output.shape for output in outputs] != [(count, 2), (count, 2), (count,)]:
            raise ModelError(
                f"{self._path} gave {shapes} instead of points0 (N, 2), points1 (N, 2) and "
                "scores (N,) for N matches; export it without a batch dimension in its outputs"
            )
        for name, output in named.items():
            if not np.all(np.isfinite(output)):
                raise ModelError(
                    f"{self._path}: output {name} holds values that are not finite; does the "
                    "same happen in the framework that it was exported from?"
                )
        return [np.asarray(output, dtype=np.float64) for output in outputs]

    def _to_image(self, points: Float64Array, image: OnnxImage, name: str) -> Float64Array:
        """The network's points in pixels of the image; both have the first pixel's corner at
        the origin, where lengths just scale."""
        pixels = points + (0.5 - self._settings.top_left_pixel_centre)
        height, width = image.tensor.shape[2:]
        outside = np.any((pixels < -_SLACK) | (pixels > np.array([width, height]) + _SLACK), axis=1)
        if np.any(outside):
            x, y = points[outside][0]
            raise ModelError(
                f"{self._path}: {outside.sum()} of {len(points)} {name} lie outside of the "
                f"{width}x{height} image, the first at ({x:.1f}, {y:.1f}); points must be "
                "(x, y) in pixels of the network's input"
            )
        return pixels * image.scale

    def _check_inputs(self) -> tuple[int, tuple[int | None, int | None]]:
        """Channels, and width and height where they are fixed."""
        inputs = {each.name: each for each in self._session.get_inputs()}
        if set(inputs) != set(_INPUTS):
            raise ModelError(
                f"{self._path} takes {', '.join(inputs)}; a matcher takes image0 and image1 "
                "(docs/formats.md); export it with these names"
            )
        for each in inputs.values():
            shape = each.shape
            if each.type != "tensor(float)" or len(shape) != 4 or _fixed(shape[0]) not in (1, None):
                raise ModelError(
                    f"{self._path}: {each.name} is a {each.type} of shape {shape}; "
                    "export it for float32 of shape (1, 1 or 3, H, W)"
                )
        first, second = ([_fixed(n) for n in inputs[name].shape[1:]] for name in _INPUTS)
        if first != second or first[0] not in (1, 3):
            raise ModelError(
                f"{self._path}: images are of shapes {inputs['image0'].shape} and "
                f"{inputs['image1'].shape}; both must have the same shape, with 1 or 3 channels"
            )
        return first[0], (first[2], first[1])

    def _check_outputs(self) -> None:
        outputs = {each.name: each for each in self._session.get_outputs()}
        if missing := [name for name in _OUTPUTS if name not in outputs]:
            raise ModelError(
                f"{self._path} gives {', '.join(outputs)}, but no {' and no '.join(missing)}; "
                "a matcher gives points0, points1 and scores (docs/formats.md)"
            )
        for name, wanted in _OUTPUTS.items():
            found = outputs[name]
            if found.type not in _FLOATS or not _may_be(found.shape, wanted):
                shape = "(N, 2)" if len(wanted) == 2 else "(N,)"
                raise ModelError(
                    f"{self._path}: {name} is a {found.type} of shape {found.shape}; "
                    f"export it as float32 of shape {shape} for N matches, "
                    "without a batch dimension"
                )


def _read_settings(path: Path) -> OnnxMatcherSettings:
    """Those of a JSON file; the default ones where there is none."""
    if not path.is_file():
        return OnnxMatcherSettings()
    known = [each.name for each in fields(OnnxMatcherSettings)]
    try:
        values = parse_json(path.read_bytes())
        if not isinstance(values, dict) or not set(values) <= set(known):
            raise ValueError(f"it must be an object with some of {', '.join(known)}")
        polishing = values.pop("polish", True)
        if not isinstance(polishing, bool):
            raise ValueError(f"polish must be true or false, not {polishing!r}")
        return OnnxMatcherSettings(**values, polish=PolishSettings() if polishing else None)
    except (OSError, ValueError, SettingsError) as error:
        raise ModelError(f"{path} cannot be used: {error}; correct or delete it") from error


def _resized(pixels: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """(H, W, C) at a width and height; the corners of the image stay its corners."""
    height, width = pixels.shape[:2]
    if size == (width, height):
        return pixels
    shrinks = size[0] <= width and size[1] <= height
    resized = cv2.resize(
        pixels, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    )
    return resized.reshape(size[1], size[0], -1)


def _usable(pixels: Float64Array, image: OnnxImage) -> BoolArray:
    """Which points lie in the image, at valid places."""
    inside = np.all((pixels >= 0) & (pixels <= image.size), axis=1)
    if image.valid is not None:
        column = np.clip(pixels[:, 0].astype(np.intp), 0, image.size[0] - 1)
        row = np.clip(pixels[:, 1].astype(np.intp), 0, image.size[1] - 1)
        inside &= image.valid[row, column]
    return np.asarray(inside)


def _fixed(length: int | str | None) -> int | None:
    return length if isinstance(length, int) else None


def _may_be(found: Sequence[int | str | None], wanted: tuple[int | None, ...]) -> bool:
    """Lengths that the file leaves open are checked when it runs; so is a shape of [], which
    onnxruntime has for a shape that is not known."""
    return not found or (
        len(found) == len(wanted)
        and all(
            _fixed(n) in (None, want) or want is None for n, want in zip(found, wanted, strict=True)
        )
    )
