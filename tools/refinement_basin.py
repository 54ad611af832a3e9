"""How far off a start may be: the share of random starts that end within 1 cm and 1 degree."""

from __future__ import annotations

from itertools import cycle, islice
from pathlib import Path

import numpy as np
from refinement_cases import (
    Case,
    adam,
    displaced,
    error_of,
    new_figure,
    ours,
    progress,
    save_figure,
    table,
)

from gscpe import Localizer

DISTANCES = ((2.0, 1.0), (5.0, 2.0), (10.0, 4.0), (20.0, 8.0), (30.0, 12.0))
"""Centimetres and degrees."""


def measure_basin(localizer: Localizer, cases: list[Case], draws: int, plot: Path | None) -> None:
    """So many draws at each distance, the queries in turn; the same for every method."""
    unit = localizer.map.metres_per_unit or 1.0
    levels = sorted({localizer.settings.refinement.levels, localizer.settings.near_levels})
    methods = [ours(localizer, f"Lucas-Kanade, S = {n}", levels=n) for n in levels]
    methods.append(adam(localizer, f"Adam, S = {levels[0]}"))
    shares: dict[str, list[float]] = {method.name: [] for method in methods}
    for cm, degrees in DISTANCES:
        rng = np.random.default_rng(0)
        starts = [
            (case, displaced(case.truth, cm / 100 / unit, degrees, rng))
            for case in islice(cycle(cases), draws)
        ]
        for method in methods:
            near = []
            for case, start in progress(starts, f"{method.name}, {cm:g} cm", draws):
                track = method.run(localizer, case, start)
                end = None if track is None else track.cam_from_world[-1]
                near.append(error_of(localizer, case, end).within(1.0, 1.0))
            shares[method.name].append(float(np.mean(near)))
    print(f"Share of {draws} starts a distance that end within 1 cm and 1°:\n")
    labels = [f"{cm:g} cm / {degrees:g}°" for cm, degrees in DISTANCES]
    table(
        ["", *labels],
        ([name, *(f"{100 * s:.0f}%" for s in of_method)] for name, of_method in shares.items()),
    )
    if plot is not None:
        draw(shares, plot)


def draw(shares: dict[str, list[float]], path: Path) -> None:
    """Shares by the distance of the start."""
    figure, (axis,) = new_figure(1, 5.5, 3.4)
    for (name, of_method), style in zip(shares.items(), ("o-", "s-", "^--"), strict=False):
        axis.plot([cm for cm, _ in DISTANCES], [100 * s for s in of_method], style, label=name)
    axis.set_xticks([cm for cm, _ in DISTANCES])
    axis.set_xticklabels([f"{cm:g} cm\n{degrees:g}°" for cm, degrees in DISTANCES])
    axis.set_xlabel("start beside the true pose")
    axis.set_ylabel("ends within 1 cm and 1°, %")
    axis.set_ylim(-3, 103)
    axis.grid(visible=True, alpha=0.25)
    axis.legend(loc=(0.12, 0.12))
    save_figure(figure, path)
