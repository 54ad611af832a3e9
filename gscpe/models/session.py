# SPDX-License-Identifier: Apache-2.0
"""Opens and runs networks with onnxruntime, with typed errors."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gscpe.cores import available_cores
from gscpe.errors import MissingDependencyError, ModelError

_ERRORS_ONLY = 3
_NO_TELEMETRY = ("ORT_DISABLE_TELEMETRY", "ORT_TELEMETRY_DISABLED")  # its name in some versions


@dataclass(frozen=True)
class TensorSpec:
    """Name, element type as onnxruntime writes it, and shape (None: any length)."""

    name: str
    shape: tuple[int | None, ...]
    type: str = "tensor(float)"


@dataclass(frozen=True)
class Signature:
    """The inputs and outputs that a network must have, in this order."""

    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]


class Network:
    """An opened network of a known signature. Safe to call from several threads."""

    def __init__(self, path: str | Path, signature: Signature, threads: int | None = None) -> None:
        """Opens it.

        Raises:
            ModelError: the file is missing, damaged, or that of another network.
            MissingDependencyError: onnxruntime is not installed.
        """
        self._path = Path(path)
        self._session = open_session(path, threads)
        check_signature(self._session, path, signature)
        self._outputs = [spec.name for spec in signature.outputs]

    def run(self, inputs: Mapping[str, NDArray[np.float32]]) -> list[NDArray[Any]]:
        """The outputs, in the order of the signature.

        Raises:
            ModelError: onnxruntime refuses the inputs, or an output is not finite.
        """
        try:
            outputs: Sequence[NDArray[Any]] = self._session.run(self._outputs, dict(inputs))
        except Exception as error:  # onnxruntime's errors have no common class
            raise ModelError(f"{self._path} cannot be run: {error}") from error
        for name, output in zip(self._outputs, outputs, strict=True):
            if not np.all(np.isfinite(output)):
                raise ModelError(
                    f"{self._path}: output {name} holds values that are not finite; is the input "
                    "finite, and is the file whole? (gscpe models list)"
                )
        return list(outputs)


def open_session(path: str | Path, threads: int | None = None) -> Any:
    """An ``onnxruntime.InferenceSession`` on the CPU.

    Args:
        path: an ``.onnx`` file.
        threads: how many it may use; None: one for each core that this process may use.

    Raises:
        ModelError: the file is missing, damaged, or needs a newer onnxruntime.
        MissingDependencyError: onnxruntime is not installed.
    """
    path = Path(path)
    if not path.is_file():
        raise ModelError(f"{path} is missing; get models with: gscpe models install xfeat")
    if threads is not None and threads < 1:
        raise ModelError(f"a network needs at least one thread, not {threads}")
    onnxruntime = _import_onnxruntime()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = available_cores() if threads is None else threads
    options.inter_op_num_threads = 1
    options.log_severity_level = _ERRORS_ONLY
    # Threads that spin while they wait take the cores from whatever else runs.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors have no common class
        text = " ".join(str(error).split())
        if "opset" in text or "IR version" in text or "ir_version" in text:
            raise ModelError(
                f"{path} needs a newer onnxruntime than {onnxruntime.__version__}; "
                f"pip install --upgrade onnxruntime ({text})"
            ) from error
        raise ModelError(
            f"{path} is not a readable ONNX file (damaged?); install or export it again ({text})"
        ) from error


def _import_onnxruntime() -> Any:
    """onnxruntime, with its telemetry off.

    Being imported is enough for it to write a device id and a database of events into the user's
    cache folder, so the variables are set before; its function alone comes too late, but it is
    the way on Windows.
    """
    for name in _NO_TELEMETRY:
        os.environ.setdefault(name, "1")
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingDependencyError(
            "trained networks need onnxruntime: pip install onnxruntime"
        ) from error
    onnxruntime.disable_telemetry_events()
    return onnxruntime


def check_signature(session: Any, path: str | Path, signature: Signature) -> None:
    """Raises ModelError, naming the first difference, unless a session has this signature."""
    for kind, found, expected in (
        ("inputs", session.get_inputs(), signature.inputs),
        ("outputs", session.get_outputs(), signature.outputs),
    ):
        names, wanted = [each.name for each in found], [each.name for each in expected]
        if names != wanted:
            raise ModelError(
                f"{path} is not the expected network: its {kind} are "
                f"{', '.join(names)} instead of {', '.join(wanted)}"
            )
        for tensor, spec in zip(found, expected, strict=True):
            if tensor.type != spec.type or not _fits(tensor.shape, spec.shape):
                raise ModelError(
                    f"{path}: {spec.name} is a {tensor.type} of shape {tensor.shape} "
                    f"instead of a {spec.type} of shape {_readable(spec.shape)}"
                )


def _fits(found: Sequence[int | str | None], expected: tuple[int | None, ...]) -> bool:
    """A length that may be any must be so in the file too: there, it has a name or none."""
    return len(found) == len(expected) and all(
        (length if isinstance(length, int) else None) == wanted
        for length, wanted in zip(found, expected, strict=True)
    )


def _readable(shape: tuple[int | None, ...]) -> str:
    return "[" + ", ".join("any" if length is None else str(length) for length in shape) + "]"
