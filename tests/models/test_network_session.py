# SPDX-License-Identifier: Apache-2.0
"""Networks are opened and run with typed errors."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscpe.errors import MissingDependencyError, ModelError
from gscpe.models import Network, Signature, TensorSpec, open_session

onnx = pytest.importorskip("onnx", reason="onnx is an optional package (extra: models)")
pytest.importorskip("onnxruntime", reason="onnxruntime has no wheel here")

LOGARITHM = Signature((TensorSpec("x", (None, 2)),), (TensorSpec("y", (None, 2)),))


def write_logarithm(path: Path, *, opset: int = 17, ir_version: int = 8) -> Path:
    """A network that takes the logarithm of a (N, 2) array."""
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [helper.make_node("Log", ["x"], ["y"])],
        "logarithm",
        [helper.make_tensor_value_info("x", kind, ["n", 2])],
        [helper.make_tensor_value_info("y", kind, ["n", 2])],
    )
    opsets = [helper.make_opsetid("", opset)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=ir_version)
    path.write_bytes(model.SerializeToString())
    return path


@pytest.fixture
def logarithm(tmp_path: Path) -> Path:
    return write_logarithm(tmp_path / "log.onnx")


def test_a_network_runs(logarithm: Path) -> None:
    x = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], dtype=np.float32)
    (y,) = Network(logarithm, LOGARITHM, threads=1).run({"x": x})
    np.testing.assert_allclose(y, np.log(x), rtol=1e-6)


def test_onnxruntime_writes_no_telemetry(logarithm: Path, tmp_path: Path) -> None:
    """Left alone, it keeps a device id and events in the user's cache from its import on."""
    home = tmp_path / "home"
    home.mkdir()
    program = "import sys; from gscpe.models import open_session; open_session(sys.argv[1], 1)"
    keep = ("PATH", "PYTHONPATH", "SYSTEMROOT", "LD_LIBRARY_PATH")
    environment = {name: os.environ[name] for name in keep if name in os.environ}
    environment |= {"HOME": str(home), "USERPROFILE": str(home), "PYTHONDONTWRITEBYTECODE": "1"}
    # The tests of a continuous integration have it off anyway.
    subprocess.run([sys.executable, "-c", program, str(logarithm)], env=environment, check=True)
    assert list(home.rglob("*")) == []


@pytest.mark.parametrize("value", [-1.0, 0.0, np.nan])
def test_outputs_that_are_not_finite(value: float, logarithm: Path) -> None:
    network = Network(logarithm, LOGARITHM)
    with pytest.raises(ModelError, match=r"log\.onnx: output y holds values that are not finite"):
        network.run({"x": np.full((1, 2), value, dtype=np.float32)})


@pytest.mark.parametrize("x", [np.ones((1, 3), np.float32), np.ones((1, 2))])
def test_inputs_that_do_not_fit(x: Any, logarithm: Path) -> None:
    with pytest.raises(ModelError, match="cannot be run"):
        Network(logarithm, LOGARITHM).run({"x": x})


@pytest.mark.parametrize(
    ("inputs", "outputs", "message"),
    [
        ([TensorSpec("image", (None, 2))], LOGARITHM.outputs, "inputs are x instead of image"),
        (LOGARITHM.inputs, [*LOGARITHM.outputs, TensorSpec("z", ())], "outputs are y instead of"),
        ([TensorSpec("x", (None, 3))], LOGARITHM.outputs, r"shape \['n', 2\].*\[any, 3\]"),
        ([TensorSpec("x", (None,))], LOGARITHM.outputs, "x is a tensor"),
        (LOGARITHM.inputs, [TensorSpec("y", (5, 2))], "y is a tensor"),
        (LOGARITHM.inputs, [TensorSpec("y", (None, 2), "tensor(double)")], r"tensor\(double\)"),
    ],
)
def test_another_network(inputs: Any, outputs: Any, message: str, logarithm: Path) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        Network(logarithm, Signature(tuple(inputs), tuple(outputs)))
    assert "log.onnx" in str(caught.value)


@pytest.mark.parametrize("newer", [{"opset": 99}, {"ir_version": 99}])
def test_a_network_that_is_too_new(newer: dict[str, int], tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="needs a newer onnxruntime"):
        open_session(write_logarithm(tmp_path / "new.onnx", **newer))


def test_missing_and_damaged_files(
    logarithm: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ModelError, match="is missing; get models with: gscpe models install"):
        open_session(tmp_path / "none.onnx")
    whole = logarithm.read_bytes()
    for data in (b"", b"hello", whole[: len(whole) // 2]):
        logarithm.write_bytes(data)
        with pytest.raises(ModelError, match=r"log\.onnx"):
            Network(logarithm, LOGARITHM)
    with pytest.raises(ModelError, match="at least one thread"):
        open_session(write_logarithm(logarithm), threads=0)
    assert capfd.readouterr() == ("", "")  # onnxruntime itself is silent


def test_without_onnxruntime(logarithm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingDependencyError, match="pip install onnxruntime"):
        open_session(logarithm)
