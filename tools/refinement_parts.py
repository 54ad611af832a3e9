# SPDX-License-Identifier: Apache-2.0
"""What each part of the refinement is for: parts left out, and photos that were changed."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Callable, Sequence

import numpy as np
from _common import Case, Error, error_of, median_error, progress, share, table, within
from changed_photos import CHANGES
from refinement_methods import coarse_starts

from gscpe import Localizer
from gscpe.arrays import UInt8Array
from gscpe.geometry import se3
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


def change_photos(localizer: Localizer, cases: Sequence[Case]) -> None:
    """The whole pipeline: coarse and final errors of the queries that are localized."""
    changes: dict[str, Callable[[UInt8Array], UInt8Array]] = {"unchanged": lambda i: i, **CHANGES}
    unit = localizer.map.metres_per_unit or 1.0
    rows = []
    plain: tuple[float, float] | None = None
    for name, change in changes.items():
        coarse, final, sigmas = [], [], [0.0]
        for case in progress(cases, name):
            result = localizer.localize(change(case.image), case.query.camera)
            if not result.localized:
                continue
            assert result.coarse is not None
            assert result.cam_from_world is not None and result.covariance is not None
            xi = se3.log(case.truth @ se3.inverse(result.cam_from_world))
            sigmas.append(float(np.max(np.abs(xi) / np.sqrt(np.diag(result.covariance)))))
            coarse.append(error_of(result.coarse.cam_from_world, case.truth, unit))
            final.append(error_of(result.cam_from_world, case.truth, unit))
        localized = share([True] * len(final) + [False] * (len(cases) - len(final)))
        if not final:
            rows.append([name, localized, "", "", "", ""])
            continue
        medians = _medians(final)
        plain = plain or medians
        ratio = " / ".join(f"{a / b:.2f}" for a, b in zip(medians, plain, strict=True))
        rows.append(
            [
                name,
                localized,
                median_error(coarse),
                median_error(final),
                ratio,
                f"{max(sigmas):.1f}",
            ]
        )
    print("Medians over the queries that are localized; ratio to the unchanged photos; the largest")
    print("error in any axis, in standard deviations of the query's own covariance.\n")
    table(
        ["photos", "localized", "coarse", "final", "final, ratio (cm / °)", "worst, sigmas"], rows
    )


def _medians(errors: Sequence[Error]) -> tuple[float, float]:
    return (
        float(np.median([error.centimetres for error in errors])),
        float(np.median([error.degrees for error in errors])),
    )
