# SPDX-License-Identifier: Apache-2.0
"""Tensors of a PyTorch checkpoint, read without PyTorch and without running what is in it.

The format: a zip archive with a pickle (``data.pkl``), which names storages, and their
bytes (``data/0``, ``data/1``, ...). A pickle can call any function it names, so only the
four names that a plain checkpoint needs are known here, and none is PyTorch's.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from collections import OrderedDict
from typing import Any, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gscpe.errors import ModelError

_STORAGES: Mapping[str, np.dtype[Any]] = {
    "FloatStorage": np.dtype("<f4"),
    "DoubleStorage": np.dtype("<f8"),
    "HalfStorage": np.dtype("<f2"),
    "LongStorage": np.dtype("<i8"),
    "IntStorage": np.dtype("<i4"),
}


def read_tensors(data: bytes, name: str) -> dict[str, NDArray[Any]]:
    """The tensors of a checkpoint by their names.

    Args:
        data: the bytes of the file.
        name: what messages call it.

    Raises:
        ModelError: the file is damaged, or holds anything but plain tensors.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            root = _root(archive.namelist())
            tensors = _Reader(archive, root).load()
    except ModelError as error:
        raise ModelError(f"{name}: {error}") from error
    except Exception as error:  # zip files and pickles fail in every way when damaged
        raise ModelError(f"{name} is not a readable PyTorch file (damaged?): {error}") from error
    if not isinstance(tensors, Mapping) or not all(
        isinstance(key, str) and isinstance(value, np.ndarray) for key, value in tensors.items()
    ):
        raise ModelError(f"{name} does not hold named tensors")
    return dict(tensors)


def _root(names: Sequence[str]) -> str:
    pickles = [each for each in names if each.count("/") == 1 and each.endswith("/data.pkl")]
    if len(pickles) != 1:
        raise ModelError("not a PyTorch file of the zip format: it has no data.pkl")
    return pickles[0].removesuffix("data.pkl")


class _StorageType:
    """Stands for the element type of a storage."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.dtype = dtype


class _Reader(pickle.Unpickler):
    def __init__(self, archive: zipfile.ZipFile, root: str) -> None:
        super().__init__(io.BytesIO(archive.read(f"{root}data.pkl")))
        self._archive, self._root = archive, root

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if module == "torch" and name in _STORAGES:
            return _StorageType(_STORAGES[name])
        raise ModelError(f"it asks for {module}.{name}, which no plain checkpoint needs: refused")

    def persistent_load(self, pid: Any) -> NDArray[Any]:
        kind, storage_type, key, _device, count = pid
        if kind != "storage" or not isinstance(storage_type, _StorageType):
            raise ModelError(f"unknown reference {pid!r}")
        storage = np.frombuffer(
            self._archive.read(f"{self._root}data/{key}"), dtype=storage_type.dtype
        )
        if len(storage) != count:
            raise ModelError(f"storage {key} has {len(storage)} elements instead of {count}")
        return storage


def _tensor(
    storage: NDArray[Any], offset: int, shape: Sequence[int], strides: Sequence[int], *_: Any
) -> NDArray[Any]:
    """A tensor out of a storage; only rows in order, as every checkpoint here has them."""
    count = int(np.prod(shape, dtype=np.int64))
    steps, step = [], 1
    for length in reversed(shape):
        steps.append(step)
        step *= length
    if tuple(strides) != tuple(reversed(steps)):
        raise ModelError(f"a tensor of shape {shape} has the unusual strides {strides}")
    if offset < 0 or count < 0 or offset + count > len(storage):
        raise ModelError("a tensor reaches beyond its storage")
    return storage[offset : offset + count].reshape(tuple(shape))
