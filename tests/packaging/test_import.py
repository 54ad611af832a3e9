# SPDX-License-Identifier: Apache-2.0
"""``import gscpe`` stays light: heavy and optional packages are imported where they are used."""

from __future__ import annotations

import subprocess
import sys

HEAVY = (
    *("faiss", "gaussforge", "jinja2", "matplotlib", "moderngl", "numba", "onnx", "onnxruntime"),
    "PIL",
    *("pycolmap", "scipy", "skimage", "trimesh"),
)


def test_import_is_light() -> None:
    program = f"import sys, gscpe; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_opencv_is_there_before_pycolmap() -> None:
    """pycolmap 4.2.1, imported before them, damages the heap when OpenCV writes a PNG."""
    program = "import sys, gscpe; print([m for m in ('numpy', 'cv2') if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "['numpy', 'cv2']"
