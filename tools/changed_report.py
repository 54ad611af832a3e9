# SPDX-License-Identifier: Apache-2.0
"""The table of tools/bench_changed.py."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Sequence

import numpy as np
from _common import table
from numpy.typing import NDArray
from scipy.stats import chi2

UNCHANGED = "unchanged"
_LIMIT = float(chi2(6).ppf(0.95))
_WRONG = 5.0
"""Centimetres, or degrees, beyond which a pose is wrong."""
_RESAMPLED = 2000
_FEWEST = 5
"""Photos, for an interval."""


@dataclass(frozen=True)
class Found:
    """What came of one photo with one change; NaN where there is no pose.

    Attributes:
        photo, change: names.
        localized: whether it was.
        centimetres, degrees: error of the final pose.
        coarse, aligned: error of these poses, centimetres.
        normalized: error squared, by the covariance; 6 on average where that is right.
        sigmas: the largest error along an axis, in its own standard deviations.
        attempts: how many there were.
        matcher: of the attempt that the result comes from.
        reason: why it was not localized.
        seconds: processor time.
    """

    photo: str
    change: str
    localized: bool
    centimetres: float
    degrees: float
    coarse: float
    aligned: float
    normalized: float
    sigmas: float
    attempts: int
    matcher: str
    reason: str
    seconds: float


def report(found: Sequence[Found], changes: Sequence[str]) -> None:
    """Prints the table, and why photos were not localized."""
    print(
        f"{len({f.photo for f in found})} photos. Errors: medians over those that are localized. "
        f"Wrong: more than {_WRONG:g} cm or degrees off.\n"
        "Ratio: to the median of the same photos without a change; in brackets, the interval that "
        f"holds 95% of\nthe ratios of {_RESAMPLED} samples drawn with replacement from the photos. "
        "NEES: normalized error squared, 6 where\ncovariances are right; and the share below its "
        "95% limit. Time: of a processor, as a multiple of the same\nphotos' without a change. "
        f"All of it: {sum(f.seconds for f in found):.0f} s. Matchers: {_matchers(found)}.\n"
    )
    base = {f.photo: f for f in found if f.change == UNCHANGED}
    rows = [_row(name, [f for f in found if f.change == name], base) for name in changes]
    table(
        ["photos", "localized", "wrong", "final", "ratio, cm", "ratio, °", "rms cm",
         "NEES mean / median", "below limit", "worst, sigmas", "time: median / mean"],
        [row for row in rows if row],
    )  # fmt: skip
    lost = [f for f in found if not f.localized]
    if lost:
        print("\nNot localized:")
    for each in sorted(lost, key=lambda f: (changes.index(f.change), f.photo)):
        print(f"- {each.change}, {each.photo}: {each.reason}")


def _matchers(found: Sequence[Found]) -> str:
    """Of the results, and how often: without XFeat's weights, all are of SIFT."""
    counted = Counter(f.matcher or "none" for f in found).most_common()
    return ", ".join(f"{name} {count}" for name, count in counted)


def _row(change: str, its: Sequence[Found], base: dict[str, Found]) -> list[str]:
    """Empty where no such photo was measured."""
    its = [f for f in its if f.photo in base]
    if not its:
        return []
    there = [f for f in its if f.localized]
    seconds = np.array([f.seconds for f in its])
    usual = np.median([base[f.photo].seconds for f in its])
    cells = [change, f"{len(there)} of {len(its)}"]
    time_taken = f"{np.median(seconds) / usual:.2f} / {seconds.mean() / usual:.2f}"
    if not there:
        return [*cells, "0", *[""] * 7, time_taken]
    errors = np.array([[f.centimetres, f.degrees] for f in there])
    nees = np.array([f.normalized for f in there])
    centimetres, degrees = np.median(errors, axis=0)
    return [
        *cells,
        str(int(np.sum(errors.max(axis=1) > _WRONG))),
        f"{centimetres:.3f} cm / {degrees:.3f}°",
        *_ratios(there, base),
        f"{np.sqrt(np.mean(errors[:, 0] ** 2)):.3f}",
        f"{nees.mean():.1f} / {np.median(nees):.1f}",
        f"{100 * np.mean(nees < _LIMIT):.0f}%",
        f"{max(f.sigmas for f in there):.1f}",
        time_taken,
    ]


def _ratios(there: Sequence[Found], base: dict[str, Found]) -> list[str]:
    """Of the median errors, in centimetres and degrees, of photos that are localized both ways."""
    pairs = [(f, base[f.photo]) for f in there if base[f.photo].localized]
    if not pairs:
        return ["", ""]
    errors = np.array([[[f.centimetres, f.degrees] for f in pair] for pair in pairs])
    ratios = _ratio_of_medians(errors)
    if len(pairs) < _FEWEST or there[0].change == UNCHANGED:
        return [f"{ratio:.2f}" for ratio in ratios]
    draws = np.random.default_rng(0).integers(0, len(pairs), (_RESAMPLED, len(pairs)))
    lower, upper = np.quantile(
        [_ratio_of_medians(errors[each]) for each in draws], [0.025, 0.975], 0
    )
    return [
        f"{ratio:.2f} ({a:.2f} to {b:.2f})"
        for ratio, a, b in zip(ratios, lower, upper, strict=True)
    ]


def _ratio_of_medians(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2,) of (N, 2, 2): of each photo, changed and unchanged, the errors in both units."""
    changed, unchanged = np.median(errors, axis=0)
    return np.asarray(changed / unchanged)
