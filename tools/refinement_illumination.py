"""The whole pipeline on photos that were changed."""

from __future__ import annotations

from typing import Callable, Sequence

import numpy as np
from refinement_cases import Case, Error, error_of, median_error, progress, share, table
from refinement_photos import CHANGES

from gscpe import Localizer
from gscpe.arrays import UInt8Array


def change_light(localizer: Localizer, cases: list[Case]) -> None:
    """Errors of the coarse and the final pose, of the queries that are localized."""
    changes: dict[str, Callable[[UInt8Array], UInt8Array]] = {"unchanged": lambda i: i, **CHANGES}
    rows = []
    plain: tuple[float, float] | None = None
    for name, change in changes.items():
        coarse, final = [], []
        for case in progress(cases, name):
            result = localizer.localize(change(case.image), case.query.camera)
            if not result.localized:
                continue
            assert result.coarse is not None
            coarse.append(error_of(localizer, case, result.coarse.cam_from_world))
            final.append(error_of(localizer, case, result.cam_from_world))
        localized = share([True] * len(final) + [False] * (len(cases) - len(final)))
        if not final:
            rows.append([name, localized, "", "", ""])
            continue
        medians = _medians(final)
        plain = plain or medians
        ratio = " / ".join(f"{a / b:.2f}" for a, b in zip(medians, plain, strict=True))
        rows.append([name, localized, median_error(coarse), median_error(final), ratio])
    print("Medians over the queries that are localized; ratio to the unchanged photos.\n")
    table(["photos", "localized", "coarse", "final", "final, ratio (cm / °)"], rows)


def _medians(errors: Sequence[Error]) -> tuple[float, float]:
    return (
        float(np.median([error.centimetres for error in errors])),
        float(np.median([error.degrees for error in errors])),
    )
