# SPDX-License-Identifier: Apache-2.0
"""Trained networks: where they are, how they are made, how they are opened."""

from gscpe.models.folder import InstalledFile, installed_files, model_path, models_folder
from gscpe.models.session import Network, Signature, TensorSpec, check_signature, open_session

__all__ = [
    "InstalledFile",
    "Network",
    "Signature",
    "TensorSpec",
    "check_signature",
    "installed_files",
    "model_path",
    "models_folder",
    "open_session",
]
