# SPDX-License-Identifier: Apache-2.0
"""The files of a map folder, as bytes: how a map is split into them and put together again.

A plain map keeps the Gaussians in ``gaussians.npz``, a compressed one in ``gaussians.spz``
with what that format cannot hold in ``gaussians.json``; see docs/formats.md.
"""

from __future__ import annotations

import base64
import io
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Mapping

import numpy as np
from numpy.typing import NDArray

from gscpe.errors import MapError, OutputError
from gscpe.geometry.camera import Camera
from gscpe.given import parse_json
from gscpe.scene.map import Map
from gscpe.scene.map_frame import MapFrame
from gscpe.scene.references import DescriberModel, GlobalDescriptors, References
from gscpe.splats.compression import compress, decompressed
from gscpe.splats.gaussians import GaussianScene
from gscpe.splats.splat_file import splat_from_bytes

GAUSSIANS = frozenset({"gaussians.npz", "gaussians.spz"})
"""One of them is in every map."""
_GAUSSIANS, _REFERENCES, _RETRIEVAL = "gaussians.npz", "references.json", "retrieval.npz"
_SPZ, _SPZ_FACTOR = "gaussians.spz", "gaussians.json"
PLAIN = frozenset({_GAUSSIANS, _REFERENCES, _RETRIEVAL})
"""The files of a plain map, except map.json."""
COMPRESSED = frozenset({_SPZ, _SPZ_FACTOR, _REFERENCES, _RETRIEVAL})
"""The files of a compressed map, except map.json."""

VLAD = "vlad"
"""The method of maps that do not say theirs."""

_SCENE_ARRAYS = ("means", "quaternions", "scales", "opacities", "sh")


def to_contents(map_: Map, compress: bool) -> dict[str, bytes]:
    """File names and contents.

    Raises:
        OutputError: the scene does not fit into the compressed format.
        MissingDependencyError: compressing needs gaussforge, and it is not installed.
    """
    return {
        **(_compressed_gaussians(map_) if compress else _plain_gaussians(map_)),
        _REFERENCES: _references_to_json(map_.references),
        _RETRIEVAL: _retrieval_to_npz(map_.descriptors, compress),
    }


def from_contents(contents: Mapping[str, bytes], folder: Path) -> Map:
    """The map of these files, which lie in this folder (gaussforge reads from there).

    Raises:
        MissingDependencyError: the map is compressed, and gaussforge is not installed.
        Exception: whatever parsers raise where a file is damaged.
    """
    load = _load_plain if _GAUSSIANS in contents else _load_compressed
    scene, frame = load(contents, folder)
    return Map(
        scene=scene,
        references=_references_from_json(contents[_REFERENCES]),
        descriptors=_retrieval_from_npz(contents[_RETRIEVAL]),
        frame=frame,
    )


REFERENCE_FILES = (_REFERENCES, _RETRIEVAL)
"""What retrieval needs."""


def references_from_contents(
    contents: Mapping[str, bytes],
) -> tuple[References, GlobalDescriptors]:
    """References, in the map's frame, and their descriptors; without the Gaussians.

    Raises:
        Exception: whatever parsers raise where a file is damaged.
    """
    return (
        _references_from_json(contents[_REFERENCES]),
        _retrieval_from_npz(contents[_RETRIEVAL]),
    )


def _plain_gaussians(map_: Map) -> dict[str, bytes]:
    arrays = _scene_arrays(map_.scene)
    arrays["near"] = np.array(map_.scene.near)
    arrays["frame"] = np.array(json.dumps(_frame_to_data(map_.frame)))
    return {_GAUSSIANS: _npz(arrays)}


def _load_plain(contents: Mapping[str, bytes], folder: Path) -> tuple[GaussianScene, MapFrame]:
    gaussians = _load_npz(contents[_GAUSSIANS])
    scene = replace(_scene_from_arrays(gaussians), near=float(gaussians["near"]))
    return scene, _frame_from_data(parse_json(str(gaussians["frame"])))


def _frame_to_data(frame: MapFrame) -> dict[str, Any]:
    return {
        "origin": frame.origin.tolist(),
        "scale": frame.scale,
        "metres_per_unit": frame.metres_per_unit,
    }


def _frame_from_data(data: Mapping[str, Any]) -> MapFrame:
    unit = data["metres_per_unit"]
    return MapFrame(
        origin=np.array(data["origin"], dtype=np.float64),
        scale=float(data["scale"]),
        metres_per_unit=None if unit is None else float(unit),
    )


def _compressed_gaussians(map_: Map) -> dict[str, bytes]:
    try:
        compressed = compress(map_.scene)
    except OutputError as error:
        raise OutputError(
            f"the map cannot be compressed ({error}); save it plain, without --compress"
        ) from None
    rest: dict[str, Any] = {
        "factor": 2.0**compressed.exponent,
        "near": map_.scene.near,
        "frame": _frame_to_data(map_.frame),
    }
    if compressed.apart is not None:
        rest["apart"] = base64.b64encode(_npz(_scene_arrays(compressed.apart))).decode()
    return {_SPZ: compressed.spz, _SPZ_FACTOR: json.dumps(rest).encode()}


def _load_compressed(contents: Mapping[str, bytes], folder: Path) -> tuple[GaussianScene, MapFrame]:
    rest = parse_json(contents[_SPZ_FACTOR])
    factor = float(rest["factor"])
    if not 0 < factor < np.inf:
        raise MapError(f"the factor of the coordinates is {factor}")
    many = splat_from_bytes(contents[_SPZ], folder / _SPZ)
    apart = None
    if "apart" in rest:
        apart = _scene_from_arrays(_load_npz(base64.b64decode(rest["apart"], validate=True)))
    scene = replace(decompressed(many, factor, apart), near=float(rest["near"]))
    return scene, _frame_from_data(rest["frame"])


def _scene_arrays(scene: GaussianScene) -> dict[str, NDArray[Any]]:
    arrays = {name: np.asarray(getattr(scene, name)) for name in _SCENE_ARRAYS}
    return {**arrays, "antialiased": np.array(scene.antialiased)}


def _scene_from_arrays(arrays: Mapping[str, NDArray[Any]]) -> GaussianScene:
    return GaussianScene(
        means=arrays["means"],
        quaternions=arrays["quaternions"],
        scales=arrays["scales"],
        opacities=arrays["opacities"],
        sh=arrays["sh"],
        antialiased=bool(arrays["antialiased"]),
    )


def _npz(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _load_npz(data: bytes) -> dict[str, NDArray[Any]]:
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _retrieval_to_npz(known: GlobalDescriptors, compress: bool) -> bytes:
    # Half precision moves a similarity by less than 0.001.
    arrays: dict[str, NDArray[Any]] = {
        "vocabulary": known.vocabulary,
        "descriptors": known.descriptors.astype(np.float16 if compress else np.float32),
    }
    if known.method != VLAD:
        recipe = {"method": known.method, "model": known.model and asdict(known.model)}
        arrays["recipe"] = np.array(json.dumps(recipe))
    return _npz(arrays)


def _retrieval_from_npz(data: bytes) -> GlobalDescriptors:
    arrays = _load_npz(data)
    recipe: dict[str, Any] = {"method": VLAD}
    if "recipe" in arrays:
        recipe = parse_json(str(arrays["recipe"]))
    model = recipe.get("model")
    return GlobalDescriptors(
        vocabulary=np.asarray(arrays["vocabulary"], dtype=np.float32),
        descriptors=np.asarray(arrays["descriptors"], dtype=np.float32),
        method=str(recipe["method"]),
        model=None if model is None else _describer_model(model),
    )


def _describer_model(data: Mapping[str, Any]) -> DescriberModel:
    return DescriberModel(str(data["file"]), str(data["sha256"]), str(data["input"]))


def _references_to_json(references: References) -> bytes:
    entries = [
        {
            "name": name,
            "camera": camera.colmap_text(),
            "cam_from_world": pose.tolist(),
            **({"virtual": True} if references.virtual else {}),
        }
        for name, camera, pose in zip(
            references.names, references.cameras, references.cam_from_world, strict=True
        )
    ]
    return json.dumps(entries, indent=1).encode()


def _references_from_json(data: bytes) -> References:
    entries = parse_json(data)
    return References(
        names=tuple(str(entry["name"]) for entry in entries),
        cam_from_world=np.array([entry["cam_from_world"] for entry in entries], dtype=np.float64),
        cameras=tuple(Camera.parse(entry["camera"]) for entry in entries),
        virtual=any(entry.get("virtual", False) for entry in entries),
    )
