# SPDX-License-Identifier: Apache-2.0
"""PyTorch checkpoints are read, and nothing in them is run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from networks import checkpoint, name_in_pickle, number, tensor, text, zipped

from gscpe.errors import ModelError
from gscpe.models.torch_file import read_tensors

ARRAY = np.arange(24, dtype=np.float32).reshape(2, 3, 4)


def test_tensors_come_back() -> None:
    arrays = {"a.weight": ARRAY, "b": np.array([2.5], dtype=np.float32), "steps": np.array(7)}
    back = read_tensors(checkpoint(arrays), "some.pt")
    assert list(back) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].shape == array.shape


@pytest.mark.parametrize(
    "function", ["os system", "builtins eval", "torch.storage _load_from_bytes", "torch load"]
)
def test_a_pickle_that_would_run_something_is_refused(function: str, tmp_path: Path) -> None:
    module, name = function.split()
    trace = tmp_path / "it-ran"
    program = name_in_pickle(module, name) + b"(" + text(f"touch {trace}") + b"tR"
    with pytest.raises(ModelError, match=rf"some\.pt: it asks for {module}\.{name}"):
        read_tensors(zipped(program, {}), "some.pt")
    assert not trace.exists()


def test_tensors_that_do_not_fit_their_storage() -> None:
    def refused(program: bytes, storage: bytes) -> str:
        with pytest.raises(ModelError) as caught:
            read_tensors(zipped(b"(" + text("a") + program + b"d", {"0": storage}), "some.pt")
        return str(caught.value)

    assert "unusual strides" in refused(tensor("0", ARRAY, strides=(1, 2, 6)), ARRAY.tobytes())
    assert "elements instead of" in refused(tensor("0", ARRAY), ARRAY.tobytes()[:-4])
    beyond = tensor("0", ARRAY).replace(b"tQ" + number(0), b"tQ" + number(1))
    assert "beyond its storage" in refused(beyond, ARRAY.tobytes())


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"hello",
        zipped(b"N", {}),
        zipped(b"}", {}).replace(b"archive/data.pkl", b"archive/other.pk"),
        zipped(b"(" + text("a") + number(3) + b"d", {}),
        zipped(b"\xff", {}),
        zipped(b"(" + text("a") + tensor("9", ARRAY) + b"d", {}),
    ],
)
def test_what_is_no_checkpoint(data: bytes) -> None:
    with pytest.raises(ModelError, match=r"some\.pt"):
        read_tensors(data, "some.pt")


def test_damaged_files() -> None:
    """Cut off or changed, a file is refused; a change where nothing is read may pass."""
    rng = np.random.default_rng(0)
    data = checkpoint({"a": ARRAY, "b": ARRAY[0]})
    for _ in range(40):
        with pytest.raises(ModelError):
            read_tensors(data[: rng.integers(len(data))], "some.pt")
        changed = bytearray(data)
        changed[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        try:
            read_tensors(bytes(changed), "some.pt")
        except ModelError as error:
            assert "some.pt" in str(error)
