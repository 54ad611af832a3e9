# SPDX-License-Identifier: Apache-2.0
"""The methods by name: describing a map's references, and queries alike."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Iterable, Sequence

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float32Array
from gscpe.errors import MapError, ModelError, SettingsError
from gscpe.geometry.spread import evenly_spread
from gscpe.models import models_folder
from gscpe.photos import Photo
from gscpe.retrieval.onnx_describer import OnnxDescriber, describe_model, read_onnx_input
from gscpe.retrieval.protocol import GlobalDescriber
from gscpe.retrieval.vlad import VocabularySettings, aggregate, learn_vocabulary
from gscpe.retrieval.vlad_describer import LocalDescriptors, VladDescriber, rootsift, xfeat
from gscpe.scene import DescriberModel, GlobalDescriptors

METHODS = ("vlad", "vlad-xfeat", "onnx:PATH")
"""VLAD of RootSIFT; VLAD of XFeat; a network that was exported to ONNX."""

_WORDS = {"vlad": 64, "vlad-xfeat": 128}
_WIDTH = {"vlad": 128, "vlad-xfeat": 64}
_TRAINING_PHOTOS = 512


def check_method(method: str) -> None:
    """Raises, before any long work, what :func:`describe_references` would raise at its start.

    Raises:
        SettingsError: there is no such method.
        ModelError: its network is missing, damaged, or of another form.
        MissingDependencyError: it needs onnxruntime, and that is not installed.
    """
    kind, path = parse_method(method)
    if kind == "onnx":
        OnnxDescriber(path)
    else:
        _local_descriptors(kind)


def parse_method(method: str) -> tuple[str, str]:
    """The kind of method, and the path of the network, "" where there is none.

    Raises:
        SettingsError: there is no such method.
    """
    if isinstance(method, str):
        kind, _, path = method.partition(":")
        if method in _WORDS or (kind == "onnx" and path):
            return kind, path
    raise SettingsError(
        f"there is no retrieval method {method!r}; the methods are {', '.join(METHODS)}"
    )


def describe_references(
    photos: Sequence[Photo], method: str = "vlad", progress: bool = False
) -> GlobalDescriptors:
    """Describes each photo; for VLAD, with a vocabulary that is learned from them.

    Photos are asked for one at a time, so they need not fit into memory together.

    Raises:
        MapError: there are no photos.
        SettingsError, ModelError, MissingDependencyError: as :func:`check_method`.
    """
    kind, path = parse_method(method)
    if not len(photos):
        raise MapError("a map needs at least one reference photo")
    if kind == "onnx":
        network = OnnxDescriber(path)
        rows = [
            _describe(network, photos[index])
            for index in _shown(range(len(photos)), "describing reference photos", progress)
        ]
        vocabulary = np.zeros((0, 0), dtype=np.float32)
        return GlobalDescriptors(vocabulary, np.stack(rows), kind, network.record())
    return _describe_by_vlad(photos, kind, progress)


def open_describer(known: GlobalDescriptors, model: str | Path | None = None) -> GlobalDescriber:
    """What describes a query as a map's references were described.

    Args:
        known: of the map.
        model: path of the network that described them, where that was an exported one; None:
            the file of that name in :func:`descriptors_folder`.

    Raises:
        MapError: the map was described by a method that this gscpe does not know, or what it
            keeps of it does not fit together.
        ModelError: the network is missing, damaged, or another one than the map was built with.
        MissingDependencyError: it needs onnxruntime, and that is not installed.
    """
    if known.method == "onnx":
        if known.model is None:
            raise MapError("the map does not say which network described it; build it again")
        return _open_onnx(known.model, model)
    if known.method not in _WORDS:
        raise MapError(
            f"the map's references were described by {known.method!r}, which this gscpe does not "
            "know; update gscpe, or build the map again"
        )
    expected = (known.descriptors.shape[1] // _WIDTH[known.method], _WIDTH[known.method])
    if len(known.descriptors) and known.vocabulary.shape != expected:
        raise MapError(
            f"the map's vocabulary, {known.vocabulary.shape}, and descriptors, "
            f"{known.descriptors.shape}, are not those of {known.method}; build it again"
        )
    return VladDescriber(_local_descriptors(known.method), known.vocabulary)


def descriptors_folder() -> Path:
    """Where exported networks are looked for."""
    return models_folder() / "descriptors"


def _open_onnx(recorded: DescriberModel, given: str | Path | None) -> GlobalDescriber:
    path = Path(given) if given is not None else descriptors_folder() / Path(recorded.file).name
    if not path.is_file():
        raise ModelError(
            f"the map's references were described by {recorded.file} (SHA-256 "
            f"{recorded.sha256}), and {path} is missing; put the file and its .json there"
        )
    found = describe_model(path, read_onnx_input(path))
    if found.sha256 != recorded.sha256:
        raise ModelError(
            f"{path} (SHA-256 {found.sha256}) is not the network that described the map's "
            f"references, {recorded.file} (SHA-256 {recorded.sha256}); use that one, or build "
            "the map again"
        )
    if found.input != recorded.input:
        raise ModelError(
            f"{path.with_suffix('.json')} differs from the one that the map was built with: "
            f"{found.input} instead of {recorded.input}"
        )
    return OnnxDescriber(path)


def _describe_by_vlad(photos: Sequence[Photo], kind: str, progress: bool) -> GlobalDescriptors:
    local_descriptors = _local_descriptors(kind)

    def local_of(index: int) -> Float32Array:
        photo = photos[index]
        return local_descriptors(photo.rgb, None, photo.valid)

    chosen = evenly_spread(len(photos), _TRAINING_PHOTOS)
    kept = {
        int(index): local_of(int(index))
        for index in _shown(chosen, "learning words from photos", progress)
    }
    vocabulary = learn_vocabulary(list(kept.values()), VocabularySettings(_WORDS[kind]))
    rows = [
        aggregate(kept.pop(index) if index in kept else local_of(index), vocabulary)
        for index in _shown(range(len(photos)), "describing reference photos", progress)
    ]
    return GlobalDescriptors(vocabulary, np.stack(rows), kind)


def _describe(describer: GlobalDescriber, photo: Photo) -> Float32Array:
    return describer.describe(photo.rgb, None, photo.valid)


def _local_descriptors(kind: str) -> LocalDescriptors:
    return xfeat() if kind == "vlad-xfeat" else rootsift


def _shown(indices: Iterable[int], what: str, progress: bool) -> Iterable[int]:
    bar: Iterable[int] = tqdm(
        indices, desc=what, unit="photo", disable=not (progress and sys.stderr)
    )
    return bar
