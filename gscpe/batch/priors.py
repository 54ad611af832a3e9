# SPDX-License-Identifier: Apache-2.0
"""One prior a photo of a list: read from a pose file, and part of the fingerprint."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Mapping, Sequence

from gscpe.errors import PoseError
from gscpe.localization import PosePrior
from gscpe.poses import read_pose_file
from gscpe.scene.query_list import Query


def read_priors(
    path: str | Path,
    queries: Sequence[Query],
    translation_sigma: float = PosePrior.translation_sigma,
    rotation_sigma_degrees: float = PosePrior.rotation_sigma_degrees,
) -> dict[str, PosePrior]:
    """The priors of those queries that a pose file has a pose of, by name.

    Args:
        path: a file of poses by photo, of any form that :func:`gscpe.read_pose_file` reads.
        queries: of the list; other photos of the file are left out.
        translation_sigma, rotation_sigma_degrees: of all of them; see :class:`gscpe.PosePrior`.

    Raises:
        PoseError: the file cannot be read, has a pose of none of the queries, or a deviation is
            not positive.
    """
    poses = read_pose_file(path).poses
    priors = {
        query.name: PosePrior(poses[query.name], translation_sigma, rotation_sigma_degrees)
        for query in queries
        if query.name in poses
    }
    if not priors:
        example = f", which begins with {next(iter(poses))}" if poses else ""
        raise PoseError(
            f"{path} has no pose for any photo of the list{example}; the names must match"
        )
    return priors


def with_priors(settings_fingerprint: str, priors: Mapping[str, PosePrior]) -> str:
    """The fingerprint of settings and priors: 12 hexadecimal digits; without priors, as it was."""
    if not priors:
        return settings_fingerprint
    digest = hashlib.sha256(settings_fingerprint.encode())
    for name, prior in sorted(priors.items()):
        sigmas = prior.translation_sigma, prior.rotation_sigma_degrees
        digest.update(f"{name} {sigmas!r}".encode())
        digest.update(prior.cam_from_world.tobytes())
    return digest.hexdigest()[:12]
