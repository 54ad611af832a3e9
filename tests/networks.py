# SPDX-License-Identifier: Apache-2.0
"""Checkpoints with random weights, written as PyTorch writes them, and networks made of them."""

from __future__ import annotations

import io
import zipfile
from typing import Any, Mapping

import numpy as np
from numpy.typing import NDArray

from gscpe.models.lighterglue_graph import LAYERS, WIDTH
from gscpe.models.xfeat_graph import BLOCKS

Arrays = Mapping[str, NDArray[Any]]


def name_in_pickle(module: str, name: str) -> bytes:
    """The instruction that puts ``module.name`` on the stack."""
    return f"c{module}\n{name}\n".encode()


def text(value: str) -> bytes:
    return b"X" + len(value.encode()).to_bytes(4, "little") + value.encode()


def number(value: int) -> bytes:
    return f"I{value}\n".encode()


def numbers(values: tuple[int, ...]) -> bytes:
    return b"(" + b"".join(number(value) for value in values) + b"t"


def tensor(key: str, array: NDArray[Any], strides: tuple[int, ...] | None = None) -> bytes:
    """The instructions that rebuild one tensor from storage ``key``."""
    kind = {"f": "FloatStorage", "i": "LongStorage"}[array.dtype.kind]
    steps = tuple(step // array.itemsize for step in array.strides)
    return (
        name_in_pickle("torch._utils", "_rebuild_tensor_v2")
        + (b"((" + text("storage") + name_in_pickle("torch", kind) + text(key) + text("cpu"))
        + (number(array.size) + b"tQ" + number(0) + numbers(array.shape))
        + (numbers(steps if strides is None else strides) + b"I00\n")
        + (name_in_pickle("collections", "OrderedDict") + b")RtR")
    )


def zipped(program: bytes, storages: Mapping[str, bytes]) -> bytes:
    """A checkpoint of a pickle program (without its end) and storages."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("archive/data.pkl", b"\x80\x02" + program + b".")
        for key, data in storages.items():
            archive.writestr(f"archive/data/{key}", data)
        archive.writestr("archive/version", "3\n")
    return buffer.getvalue()


def checkpoint(arrays: Arrays) -> bytes:
    """A checkpoint that holds these float32 or int64 arrays."""
    items = b"".join(text(n) + tensor(str(i), a) for i, (n, a) in enumerate(arrays.items()))
    program = name_in_pickle("collections", "OrderedDict") + b")R(" + items + b"u"
    return zipped(program, {str(i): a.tobytes() for i, a in enumerate(arrays.values())})


def random_xfeat(rng: np.random.Generator) -> dict[str, NDArray[np.float32]]:
    """Weights of XFeat that keep the sizes of activations near 1."""
    weights: dict[str, NDArray[np.float64]] = {
        "skip1.1.weight": rng.normal(size=(24, 1, 1, 1)),
        "skip1.1.bias": rng.normal(size=24),
    }
    for block, layers in BLOCKS.items():
        for i, (inputs, outputs, size, _, plain) in enumerate(layers):
            kernel = rng.normal(size=(outputs, inputs, size, size)) / np.sqrt(inputs * size**2 / 2)
            if plain:
                weights[f"{block}.{i}.weight"] = kernel
                weights[f"{block}.{i}.bias"] = rng.normal(size=outputs)
            else:
                weights[f"{block}.{i}.layer.0.weight"] = kernel
                weights[f"{block}.{i}.layer.1.running_mean"] = rng.normal(0, 0.3, size=outputs)
                weights[f"{block}.{i}.layer.1.running_var"] = rng.uniform(0.5, 2.0, size=outputs)
    return {name: value.astype(np.float32) for name, value in weights.items()}


def random_lighterglue(rng: np.random.Generator) -> dict[str, NDArray[np.float32]]:
    """Weights of LighterGlue that keep the sizes of activations near 1."""
    layers = {"input_proj": (WIDTH, 64)}
    norms = []
    for i in range(LAYERS):
        own, other = f"transformers.{i}.self_attn", f"transformers.{i}.cross_attn"
        layers[f"{own}.Wqkv"] = (3 * WIDTH, WIDTH)
        layers[f"{own}.out_proj"] = (WIDTH, WIDTH)
        for part in ("to_qk", "to_v", "to_out"):
            layers[f"{other}.{part}"] = (WIDTH, WIDTH)
        for block in (own, other):
            layers[f"{block}.ffn.0"] = (2 * WIDTH, 2 * WIDTH)
            layers[f"{block}.ffn.3"] = (WIDTH, 2 * WIDTH)
            norms.append(f"{block}.ffn.1")
        layers[f"log_assignment.{i}.matchability"] = (1, WIDTH)
        layers[f"log_assignment.{i}.final_proj"] = (WIDTH, WIDTH)
    weights = {"matcher.posenc.Wr.weight": rng.normal(size=(WIDTH // 2, 2))}
    for name, shape in layers.items():
        weights[f"matcher.{name}.weight"] = rng.normal(size=shape) / np.sqrt(shape[1])
        weights[f"matcher.{name}.bias"] = 0.1 * rng.normal(size=shape[0])
    for name in norms:
        weights[f"matcher.{name}.weight"] = rng.uniform(0.5, 1.5, size=2 * WIDTH)
        weights[f"matcher.{name}.bias"] = 0.1 * rng.normal(size=2 * WIDTH)
    return {name: value.astype(np.float32) for name, value in weights.items()}
