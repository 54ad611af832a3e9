# SPDX-License-Identifier: Apache-2.0
"""Writes ONNX graphs node by node."""

from __future__ import annotations

from typing import Any, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gscpe.errors import MissingDependencyError, ModelError

OPSET, IR_VERSION = 17, 8
"""Read by onnxruntime 1.12 (July 2022) and later."""

Shape = Sequence[int | str]
"""Lengths; those that vary have names."""

Weights = Mapping[str, NDArray[Any]]
"""Tensors by the names that they have in the checkpoint."""


class GraphWriter:
    """Collects nodes and constants. All tensors are float32 but for shapes.

    Raises:
        MissingDependencyError: the package ``onnx`` is not installed.
    """

    def __init__(self) -> None:
        try:
            import onnx
        except ImportError as error:
            raise MissingDependencyError(
                "making models needs onnx: pip install 'gscpe[models]'"
            ) from error
        self._onnx = onnx
        self._nodes: list[Any] = []
        self._constants: dict[tuple[Any, ...], Any] = {}

    def constant(self, values: ArrayLike, dtype: Any = np.float32) -> str:
        """A constant tensor, stored once however often it is used; returns its name."""
        array = np.ascontiguousarray(values, dtype=dtype).reshape(np.shape(values))
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            name = f"constant_{len(self._constants)}"
            self._constants[key] = self._onnx.numpy_helper.from_array(array, name)
        return str(self._constants[key].name)

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """A node with one output; returns the output's name."""
        return self.add_many(operator, 1, *inputs, **attributes)[0]

    def add_many(self, operator: str, outputs: int, *inputs: str, **attributes: Any) -> list[str]:
        """A node with several outputs; returns their names."""
        names = [f"{operator.lower()}_{len(self._nodes)}_{i}" for i in range(outputs)]
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, names, **attributes))
        return names

    def linear(self, x: str, weight: NDArray[Any], bias: NDArray[Any] | None = None) -> str:
        """``x @ weight.T + bias`` for (N, inputs) ``x`` and (outputs, inputs) ``weight``."""
        product = self.add("MatMul", x, self.constant(weight.T))
        return product if bias is None else self.add("Add", product, self.constant(bias))

    def finish(
        self,
        name: str,
        inputs: Mapping[str, Shape],
        outputs: Mapping[str, tuple[str, Shape]],
        metadata: Mapping[str, str],
    ) -> bytes:
        """The checked model as the bytes of an ``.onnx`` file.

        Args:
            outputs: public name of each output, with the tensor that it is and its shape.
        """
        helper, float32 = self._onnx.helper, self._onnx.TensorProto.FLOAT
        for public, (tensor, _) in outputs.items():
            self._nodes.append(helper.make_node("Identity", [tensor], [public]))
        graph = helper.make_graph(
            self._nodes,
            name,
            [helper.make_tensor_value_info(n, float32, list(s)) for n, s in inputs.items()],
            [helper.make_tensor_value_info(n, float32, list(s)) for n, (_, s) in outputs.items()],
            list(self._constants.values()),
        )
        model = helper.make_model(
            graph,
            producer_name="gscpe",
            ir_version=IR_VERSION,
            opset_imports=[helper.make_opsetid("", OPSET)],
        )
        helper.set_model_props(model, dict(metadata))
        self._onnx.checker.check_model(model, full_check=True)
        return bytes(model.SerializeToString())


def take(weights: Weights, name: str, *shape: int) -> NDArray[np.float64]:
    """One tensor of a checkpoint, in double precision so that folding factors costs nothing.

    Raises:
        ModelError: it is missing, of another shape, or not finite.
    """
    if name not in weights:
        raise ModelError(f"the checkpoint has no tensor {name}; does it belong to another network?")
    tensor = weights[name]
    if tensor.shape != shape:
        raise ModelError(f"tensor {name} is of shape {tensor.shape} instead of {shape}")
    if not np.all(np.isfinite(tensor)):
        raise ModelError(f"tensor {name} holds values that are not finite")
    return tensor.astype(np.float64)
