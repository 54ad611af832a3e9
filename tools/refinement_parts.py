# SPDX-License-Identifier: Apache-2.0
"""What each part of the refinement is for: parts left out."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Sequence

import numpy as np
from _common import Case, Error, median_error, progress, table, within
from refinement_methods import coarse_starts

from gscpe import Localizer
from gscpe.localization import fuse_matches_and_alignment
from gscpe.refinement import RefinementSettings, refine_pose


def variants(full: RefinementSettings) -> dict[str, RefinementSettings]:
    """Settings by what is left out."""
    visibility, solver = full.visibility, full.solver
    unmasked = replace(visibility, views=0, min_opacity=0.0, max_depth_step=np.inf)
    return {
        "full": full,
        "without multi-scale (S = 0)": replace(full, levels=0),
        "without mask": replace(full, visibility=unmasked),
        "two other views vote (V = 2)": replace(full, visibility=replace(visibility, views=2)),
        "never a second render": replace(full, min_anchors=1, max_anchors=1),
        "without gain and bias": replace(full, solver=replace(solver, gain_and_bias=False)),
        "without robust weights": replace(full, solver=replace(solver, robust=False)),
    }


def ablate(localizer: Localizer, cases: Sequence[Case]) -> None:
    """From the coarse poses. The final pose fuses coarse and aligned pose; both are shown."""
    settings = localizer.settings
    found = coarse_starts(localizer, cases)
    rows = []
    for name, changed in variants(settings.refinement).items():
        aligned, final, seconds = [], [], []
        for start, result in progress(found, name, len(found)):
            photo, pose = start.case.photo_in(localizer), start.cam_from_world
            begin = time.perf_counter()
            refined = refine_pose(localizer, photo, pose, changed)
            seconds.append(time.perf_counter() - begin)
            aligned.append(start.error(localizer, refined.cam_from_world))
            assert result.coarse is not None
            assert result.coarse.covariance is not None
            if refined.cam_from_world is not None and refined.covariance is not None:
                pose, _ = fuse_matches_and_alignment(
                    pose,
                    result.coarse.covariance,
                    refined.cam_from_world,
                    refined.covariance,
                    settings.fusion,
                    refined.unshared,
                )
            final.append(start.error(localizer, pose))
        rows.append([name, *_both(aligned), *_both(final), f"{np.median(seconds):.3f}"])
    coarse = [start.error(localizer, start.cam_from_world) for start, _ in found]
    rows.append(["(coarse)", *_both(coarse), "", "", ""])
    print(f"From the coarse poses of {len(found)} queries.\n")
    table(["", "aligned", "1 cm/1°", "final", "1 cm/1°", "s"], rows)


def _both(errors: Sequence[Error]) -> list[str]:
    return [median_error(errors), within(errors, 1.0, 1.0)]
