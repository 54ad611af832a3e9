"""Whether the errors of the poses are as large as their covariances say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from refinement_cases import Case, localize_cases, new_figure, save_figure, share, table
from scipy.stats import chi2

from gscpe import Localizer
from gscpe.evaluation import normalized_error_squared

_DEGREES_OF_FREEDOM = 6
_LARGEST = 30.0
"""Right end of the histogram; what is beyond is counted in its last bar."""


def check_covariance(localizer: Localizer, cases: list[Case], plot: Path | None) -> None:
    """The normalized error squared of the localized queries, against chi squared."""
    stages: dict[str, list[float]] = {"coarse": [], "alignment alone": [], "final": []}
    for case, result in localize_cases(localizer, cases):
        if not result.localized:
            continue
        for name, stage in zip(stages, (result.coarse, result.refined, result), strict=True):
            assert stage is not None
            assert stage.cam_from_world is not None
            assert stage.covariance is not None
            stages[name].append(
                normalized_error_squared(stage.cam_from_world, stage.covariance, case.truth)
            )
    expected = chi2(_DEGREES_OF_FREEDOM)
    limit = expected.ppf(0.95)
    print(f"Normalized error squared of {len(stages['final'])} localized queries:\n")
    rows = [
        [name, f"{np.mean(v):.2f}", f"{np.median(v):.2f}", share([x <= limit for x in v])]
        for name, v in stages.items()
    ]
    rows.append(["(chi squared)", f"{expected.mean():.2f}", f"{expected.median():.2f}", "95%"])
    table(["", "mean", "median", f"below {limit:.1f}"], rows)
    if plot is not None:
        draw(stages, plot)


def draw(stages: dict[str, list[float]], path: Path) -> None:
    """Histograms, and the density that right covariances would give."""
    figure, axes = new_figure(len(stages), 3.2 * len(stages), 3.0)
    x = np.linspace(0.0, _LARGEST, 200)
    bins = np.linspace(0.0, _LARGEST, 16)
    for axis, (name, values) in zip(axes, stages.items(), strict=True):
        axis.hist(np.minimum(values, _LARGEST), bins, density=True, alpha=0.5, label="queries")
        axis.plot(x, chi2(_DEGREES_OF_FREEDOM).pdf(x), "C1", label="chi squared, 6 d.o.f.")
        axis.set_title(name)
        axis.set_xlabel("normalized error squared")
    axes[0].set_ylabel("density")
    axes[-1].legend(fontsize=8)
    save_figure(figure, path)
