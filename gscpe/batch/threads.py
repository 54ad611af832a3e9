"""How many threads a worker uses."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import Iterator

from gscpe.cores import VARIABLE

_VARIABLES = (
    VARIABLE,  # the CPU rasterizer, onnxruntime
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"),
    *("NUMBA_NUM_THREADS", "LP_NUM_THREADS"),  # the last one: Mesa's software OpenGL
)


@contextmanager
def limited_threads(threads: int | None) -> Iterator[None]:
    """Sets the environment that libraries read when they are loaded, and processes that are
    started meanwhile inherit. None: leaves it."""
    if threads is None:
        yield
        return
    before = {name: os.environ.get(name) for name in _VARIABLES}
    os.environ.update(dict.fromkeys(_VARIABLES, str(threads)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
