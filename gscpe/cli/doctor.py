"""``gscpe doctor``: what gscpe runs on, what is missing, and how to get it."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform

from gscpe import __version__
from gscpe.cli.common import Commands
from gscpe.errors import RenderError
from gscpe.render import choose_backend, driver_info

_REQUIRED = (
    *("moderngl", "numpy", "scipy", "opencv-contrib-python-headless"),
    *("scikit-image", "tqdm", "trimesh"),
)
_OPTIONAL = {
    "numba": "rendering on the CPU, several times faster than OpenGL in software",
    "gaussforge": "splats that are not .ply: .spz, .splat, .ksplat, .sog, compressed .ply",
    "pycolmap": "reading COLMAP models (gscpe build-map)",
}


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("doctor", help="driver, OpenGL version, what is missing")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    print(f"gscpe {__version__}, Python {platform.python_version()}, {platform.platform()}")
    print(f"{os.cpu_count()} CPU cores")
    for package in _REQUIRED:
        print(f"{package:<32} {_version(package) or 'MISSING: pip install ' + package}")
    for package, use in _OPTIONAL.items():
        version = _version(package)
        print(f"{package:<32} {version or f'missing (optional), for {use}: pip install {package}'}")
    try:
        driver = driver_info()
        kind = "software, on the CPU" if driver.is_software else "hardware"
        print(f"{'OpenGL driver':<32} {driver.renderer} ({kind})")
        print(f"{'OpenGL version':<32} {driver.version}")
    except RenderError as error:
        print(f"{'OpenGL':<32} missing: {error}")
    try:
        backend = choose_backend()
    except RenderError:
        print("nothing to render with: install OpenGL or Numba, as said above")
        return 1
    print(f"{'backend':<32} {backend}")
    print("all is well: gscpe demo shows it at work")
    return 0


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
