# SPDX-License-Identifier: Apache-2.0
"""What is lost when a part is left out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

from gscpe.evaluation import published
from gscpe.evaluation.table import Table
from gscpe.evaluation.text import number_text, significant_text


@dataclass(frozen=True)
class AblationRow:
    """Median errors with a part left out; centimetres, or world units where nobody knows these."""

    name: str
    position: float
    degrees: float


def ablation_table(
    title: str,
    rows: Sequence[AblationRow],
    *,
    with_published: bool = False,
    metric: bool = True,
) -> Table:
    """Median errors, a row a variant; the paper's Office ablation below, if asked for.

    ``metric`` says whether the rows' positions are in centimetres; what is not metric does not
    stand beside the paper's.
    """
    with_published = with_published and metric
    named = [(row, False) for row in rows]
    if with_published:
        named += [(AblationRow(*row), True) for row in published.ABLATION]
    notes = ["of the image alignment alone, before its mean with the coarse pose"]
    if with_published:
        notes.append(
            f"published: {published.METHOD} on {published.DATASET} {published.ABLATION_SCENE}"
        )
    return Table(
        title,
        ("", "position (cm)" if metric else "position (world units)", "rotation (°)"),
        tuple(
            (
                f"{row.name} (published)" if theirs else row.name,
                number_text(row.position, 2 if theirs else 3)
                if metric
                else significant_text(row.position, 4),
                number_text(row.degrees, 3),
            )
            for row, theirs in named
        ),
        tuple(notes),
        tuple(
            {
                "name": row.name,
                "published": theirs,
                "median_position_cm" if metric else "median_position_units": row.position,
                "median_rotation_degrees": row.degrees,
            }
            for row, theirs in named
        ),
    )
