# SPDX-License-Identifier: Apache-2.0
"""``gscpe doctor``: what gscpe runs on, what is missing, and how to get it."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform

import numpy as np

from gscpe import __version__
from gscpe.cli.common import Commands
from gscpe.errors import ModelError, RenderError
from gscpe.geometry import Camera
from gscpe.models import installed_files, models_folder
from gscpe.render import RenderedView, Renderer, choose_backend, driver_info
from gscpe.render.context import opengl_facts
from gscpe.render.cpu_rasterizer import kept_in
from gscpe.render.diagnosis import OpenGLFacts, findings
from gscpe.splats import GaussianScene

_REQUIRED = (
    *("numpy", "scipy", "opencv-contrib-python-headless", "pillow", "jinja2", "markupsafe"),
    *("onnxruntime", "platformdirs", "scikit-image", "tqdm", "threadpoolctl", "trimesh"),
)
_NOT_EVERYWHERE = {
    "moderngl": "rendering with OpenGL",
    "pycolmap": "its RANSAC, in place of OpenCV's",
}
"""Required, but without a wheel for Arm Linux."""

_EXTRAS = {
    "cpu": (("numba",), "rendering on the CPU, several times faster than OpenGL in software"),
    "formats": (
        ("gaussforge",),
        "splats that are not .ply: .spz, .splat, .ksplat, .sog, compressed .ply",
    ),
    "heic": (("pillow-heif",), "photos of iPhones: .heic"),
    "models": (("onnx",), "making trained networks: gscpe models install"),
    "index": (("faiss-cpu",), "maps of more than 100 000 reference photos"),
    "datasets": (("pyyaml",), "data sets with calibrations in YAML"),
    "ros": (("rosbags", "pyyaml"), "following cameras in ROS bags"),
    "dask": (("distributed",), "batches on a cluster: gscpe localize --scheduler"),
    "view": (("viser",), "the map in a browser: gscpe view"),
    "serve": (
        ("fastapi", "uvicorn", "python-multipart", "websockets", "httpx"),
        "poses over HTTP: gscpe serve, gscpe.Client",
    ),
    "plots": (("matplotlib",), "the pictures that the tools draw"),
}
"""Of pyproject.toml, for those who use gscpe: packages, and what for."""

_CAMERA = Camera.pinhole(64, 48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)
_COLOUR_TOLERANCE = 1.0 / 255.0
_DEPTH_TOLERANCE = 1e-3


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("doctor", help="driver, OpenGL version, what is missing")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    print(f"gscpe {__version__}, Python {platform.python_version()}, {platform.platform()}")
    print(f"{os.cpu_count()} CPU cores")
    for package in _REQUIRED:
        _line(package, _version(package) or f"MISSING: pip install {package}")
    for package, use in _NOT_EVERYWHERE.items():
        missing = f"missing, for {use} (no wheel for Arm Linux): pip install {package}"
        _line(package, _version(package) or missing)
    _print_extras()
    whole = _print_models()
    facts = _print_driver()
    views = {backend: view for backend in ("gl", "cpu") if (view := _try(backend)) is not None}
    agree = len(views) < 2 or _agree(views["gl"], views["cpu"])
    return _verdict(views, agree, facts.is_software, whole)


def _print_extras() -> None:
    """Each package once, and of each extra what is missing."""
    versions = {name: _version(name) for packages, _ in _EXTRAS.values() for name in packages}
    for name, version in versions.items():
        if version is not None:
            _line(name, version)
    for extra, (packages, use) in _EXTRAS.items():
        if missing := ", ".join(name for name in packages if versions[name] is None):
            _line(missing, f"missing (optional), for {use}: pip install 'gscpe[{extra}]'")


def _print_models() -> bool:
    """Whether no installed network is damaged; one that is missing is optional."""
    try:
        _line("models are in", str(models_folder()))
    except ModelError as error:
        _line("models are in", f"no folder: {error}")
    files = installed_files()
    for model in sorted({file.model for file in files}):
        states = {file.state for file in files if file.model == model}
        if states == {"ok"}:
            text = "installed"
        elif states == {"missing"}:
            text = f"missing (optional; SIFT is used instead): gscpe models install {model}"
        else:
            text = f"DAMAGED, but used by default: gscpe models install {model}"
        _line(f"model {model}", text)
    return all(file.state in ("ok", "missing") for file in files)


def _print_driver() -> OpenGLFacts:
    try:
        driver = driver_info()
    except RenderError:
        _line("OpenGL", "missing")
    else:
        kind = "software, on the CPU" if driver.is_software else "hardware"
        _line("OpenGL driver", f"{driver.renderer} ({kind}), by {driver.reached_by}")
        _line("OpenGL version", driver.version)
    facts = opengl_facts()
    for attempt in facts.failures:
        _line(f"  tried {attempt.way}", attempt.error)
    for finding in findings(facts):
        print(f"  - {finding.problem}:\n    {finding.remedy}")
    return facts


def _try(backend: str) -> RenderedView | None:
    """A tiny scene, rendered; None where that fails, which is printed."""
    try:
        with Renderer(tiny_scene(), backend) as renderer:
            view = renderer.render(_CAMERA, np.eye(4))
            if backend == "cpu":
                where = kept_in() or "no folder: each process compiles it (set NUMBA_CACHE_DIR)"
                _line("compiled code is kept in", where)
    except Exception as error:  # whatever it is, it is to be told here
        _line(f"rendering with {backend}", f"FAILED: {error}")
        return None
    if not np.isfinite(view.rgb).all() or float(view.opacity.max()) < 0.5:
        _line(f"rendering with {backend}", "FAILED: the picture is empty or not finite")
        return None
    _line(f"rendering with {backend}", "works")
    return view


def tiny_scene() -> GaussianScene:
    """50 Gaussians in a row, of all colours, from 1.5 to 4 units before the camera."""
    along = np.linspace(-1.0, 1.0, 50, dtype=np.float32)
    quaternions = np.stack([np.cos(along), 0 * along, 0 * along, np.sin(along)], axis=1)
    return GaussianScene(
        means=np.stack([along, 0.7 * np.sin(5 * along), 2.75 + 1.25 * along], axis=1),
        quaternions=quaternions,
        scales=np.tile(np.array([0.2, 0.1, 0.05], dtype=np.float32), (50, 1)),
        opacities=np.linspace(0.3, 0.95, 50, dtype=np.float32),
        sh=np.stack([along, -along, np.cos(3 * along)], axis=1)[:, None],
    )


def _agree(gl: RenderedView, cpu: RenderedView) -> bool:
    colour = float(np.abs(gl.rgb - cpu.rgb).max())
    depth = float(np.abs(gl.depth - cpu.depth)[(gl.opacity > 0.1) & (cpu.opacity > 0.1)].max())
    agree = colour <= _COLOUR_TOLERANCE and depth <= _DEPTH_TOLERANCE
    word = "yes" if agree else "NO"
    _line("do they agree", f"{word}: colours to {colour:.1g}, depths to {depth:.1g}")
    return agree


def _verdict(
    views: dict[str, RenderedView], agree: bool, is_software: bool, models_whole: bool
) -> int:
    try:
        backend = choose_backend()
    except RenderError:
        print("nothing to render with: install OpenGL or Numba, as described above")
        return 1
    reason = "OpenGL runs on a GPU"
    if backend == "cpu":
        reason = "faster than OpenGL in software" if "gl" in views else "OpenGL does not render"
    elif is_software:
        reason = "OpenGL in software, because Numba is missing"
    _line("backend chosen by auto", f"{backend}: {reason}")
    if backend not in views:
        print("rendering fails with the default backend; the reason is above")
        return 1
    if not agree:
        print("the two renderers disagree: update the graphics driver, or use another one")
        return 1
    if not models_whole:
        print("rendering works, but a network is damaged: install it again, as described above")
        return 1
    print("everything works; try gscpe demo")
    return 0


def _line(name: str, text: str) -> None:
    print(f"{name:<32} {text}")


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
