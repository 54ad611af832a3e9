# SPDX-License-Identifier: Apache-2.0
"""Gaussians, and the files that hold them."""

from gscpe.splats.gaussians import GaussianScene
from gscpe.splats.splat_file import read_splat
from gscpe.splats.write_splat import write_splat

__all__ = ["GaussianScene", "read_splat", "write_splat"]
