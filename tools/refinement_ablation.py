"""Parts of the refinement left out, from the coarse poses of the queries."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Sequence

import numpy as np
from refinement_cases import (
    Case,
    Error,
    error_of,
    localize_cases,
    median_error,
    progress,
    share,
    table,
)

from gscpe import Localizer
from gscpe.localization.fusion import fuse_matches_and_alignment
from gscpe.refinement import RefinementSettings, refine_pose


def variants(full: RefinementSettings) -> dict[str, RefinementSettings]:
    """Settings by what is left out."""
    visibility, solver = full.visibility, full.solver
    return {
        "full": full,
        "without multi-scale (S = 0)": replace(full, levels=0),
        "without mask": replace(
            full,
            visibility=replace(visibility, views=0, min_opacity=0.0, max_depth_step=np.inf),
        ),
        "mask without other views (V = 0)": replace(full, visibility=replace(visibility, views=0)),
        "never a second render": replace(full, min_anchors=1, max_anchors=1),
        "without gain and bias": replace(full, solver=replace(solver, gain_and_bias=False)),
        "without robust weights": replace(full, solver=replace(solver, robust=False)),
    }


def ablate(localizer: Localizer, cases: list[Case]) -> None:
    """The final pose fuses coarse pose and alignment; both are shown."""
    settings = variants(localizer.settings.refinement)
    unit = localizer.map.metres_per_unit
    found = localize_cases(localizer, cases)
    rows = []
    for name, changed in settings.items():
        aligned, fused, seconds = [], [], []
        for case, result in progress(found, name, len(found)):
            coarse = result.coarse
            assert coarse is not None
            assert coarse.cam_from_world is not None
            assert coarse.covariance is not None
            begin = time.perf_counter()
            refined = refine_pose(
                localizer._renderer, case.photo, coarse.cam_from_world, changed, unit
            )
            seconds.append(time.perf_counter() - begin)
            aligned.append(error_of(localizer, case, refined.cam_from_world))
            pose = coarse.cam_from_world
            if refined.cam_from_world is not None and refined.covariance is not None:
                pose, _ = fuse_matches_and_alignment(
                    pose, coarse.covariance, refined.cam_from_world, refined.covariance
                )
            fused.append(error_of(localizer, case, pose))
        rows.append(
            [name, median_error(aligned), _near(aligned), median_error(fused), _near(fused),
             f"{np.median(seconds):.3f}"]
        )  # fmt: skip
    starts = [error_of(localizer, c, r.coarse.cam_from_world) for c, r in found if r.coarse]
    rows.append(["(coarse pose)", median_error(starts), _near(starts), "", "", ""])
    print(f"From the coarse poses of {len(found)} queries.\n")
    table(
        ["", "alignment alone (without fusion)", "1 cm/1°", "fused with the coarse pose", "1 cm/1°",
         "s"],
        rows,
    )  # fmt: skip


def _near(errors: Sequence[Error]) -> str:
    return share([error.within(1.0, 1.0) for error in errors])
