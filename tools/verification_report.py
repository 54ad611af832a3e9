# SPDX-License-Identifier: Apache-2.0
"""Tables and the picture of tools/bench_verification.py."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np
from _common import new_figure, save_figure, table

from gscpe.arrays import Float64Array
from gscpe.localization import VerificationSettings

Evidence = Mapping[str, Any]

TRACKING = "tracking"
"""The kind of photos that are refined from a prior beside the truth, without matches."""
RIGHT = (0.05, 5.0)
"""Metres and degrees within which a pose of a RedKitchen photo is right, ..."""
RIGHT_TRACKED = (0.02, 2.0)
"""... and within which a tracked one is."""
_TRACKED_REACH = (0.4, 16.0)
"""Four deviations of a prior of 0.1 m and 4 degrees, the widest that is tracked from."""


@dataclass(frozen=True)
class Criterion:
    """One kind of evidence, and the threshold of VerificationSettings for it."""

    evidence: str
    setting: str
    more_is_better: bool = True

    def scores(self, attempts: Sequence[Evidence]) -> Float64Array:
        """(N,), more is better; -inf where the evidence is missing."""
        sign = 1.0 if self.more_is_better else -1.0
        values = (attempt.get(self.evidence) for attempt in attempts)
        return np.array([-np.inf if v is None else sign * v for v in values], dtype=np.float64)

    def accepts(self, attempt: Evidence, settings: VerificationSettings) -> bool:
        value, threshold = attempt.get(self.evidence), getattr(settings, self.setting)
        if value is None:
            return False
        return bool(value >= threshold if self.more_is_better else value <= threshold)

    def text(self, score: float) -> str:
        sign = 1.0 if self.more_is_better else -1.0
        return f"{sign * score:.4g}" if np.isfinite(score) else "none"


CRITERIA = (
    Criterion("inliers", "min_inliers"),
    Criterion("inlier_share", "min_inlier_share"),
    Criterion("spread", "min_spread"),
    Criterion("agreement", "min_agreement"),
    Criterion("overlap", "min_overlap"),
    Criterion("shift", "max_shift", more_is_better=False),
    Criterion("shift_degrees", "max_shift_degrees", more_is_better=False),
    Criterion("sigma", "max_sigma", more_is_better=False),
    Criterion("sigma_degrees", "max_sigma_degrees", more_is_better=False),
)


def print_report(lines: Sequence[Evidence], settings: VerificationSettings) -> None:
    photos = [line for line in lines if line["kind"] != TRACKING]
    _print_counts(photos, settings)
    _print_margins(photos, settings)
    tracked = [a for line in lines if line["kind"] == TRACKING for a in line["attempts"]]
    _print_tracking(tracked, settings)


def _print_counts(photos: Sequence[Evidence], settings: VerificationSettings) -> None:
    rows: dict[str, Counter[str]] = {}
    for photo in photos:
        row = rows.setdefault(photo["kind"], Counter())
        row["photos"] += 1
        passed = [a for a in photo["attempts"] if _passes(a, settings)]
        best = max(passed, key=_agreement, default=None)
        if best is not None:
            row["right" if _is_right(best, RIGHT) else "wrong"] += 1
    elsewhere = sum(photo["elsewhere"] for photo in photos)
    print(f"{len(photos)} photos, {elsewhere} of them of other places or of none\n")
    table(
        ["photos", "number", "localized rightly", "localized wrongly"],
        ([k, *(str(row[c]) for c in ("photos", "right", "wrong"))] for k, row in rows.items()),
    )


def _print_margins(photos: Sequence[Evidence], settings: VerificationSettings) -> None:
    """How far the threshold of each kind of evidence lies from either kind of poses."""
    plain = _split([p for p in photos if p["kind"] == "RedKitchen"])
    changed = _split([p for p in photos if p["kind"].startswith("RedKitchen, ")])
    shuffled = _split([p for p in photos if "shuffled" in p["kind"]])[1]
    others = _split([p for p in photos if p["elsewhere"] and "shuffled" not in p["kind"]])[1]
    right, wrong = _split(photos)
    print(
        f"\n{len(right)} right poses (within {100 * RIGHT[0]:.0f} cm and {RIGHT[1]:.0f} degrees), "
        f"{len(wrong)} wrong ones. Worst of the right, best of the wrong:\n"
    )
    rights, wrongs = (plain[0], changed[0]), (others, shuffled, plain[1] + changed[1])
    rows = []
    for criterion in CRITERIA:
        worst = [criterion.scores(group).min(initial=np.inf) for group in rights]
        best = [criterion.scores(group).max(initial=-np.inf) for group in wrongs]
        threshold = f"{getattr(settings, criterion.setting):g}"
        rows.append([criterion.evidence, threshold, *map(criterion.text, worst + best)])
    table(
        ["evidence", "threshold", f"right: {len(plain[0])} queries",
         f"right: {len(changed[0])} changed", f"wrong: {len(others)} of elsewhere",
         f"wrong: {len(shuffled)} shuffled", f"wrong: {len(wrongs[2])} of RedKitchen"],
        rows,
    )  # fmt: skip
    accepted, converged = (
        [sum(bool(which(attempt)) for attempt in group) for group in (right, wrong)]
        for which in (lambda a: _passes(a, settings), lambda a: a.get("converged"))
    )
    print(
        f"\nThe thresholds accept {accepted[0]} of the right and {accepted[1]} of the wrong poses; "
        f"the alignment converged for {converged[0]} and {converged[1]}."
    )


def _print_tracking(attempts: Sequence[Evidence], settings: VerificationSettings) -> None:
    with_pose = [a for a in attempts if "error" in a]
    right = [a for a in with_pose if _is_right(a, RIGHT_TRACKED)]
    wrong = [a for a in with_pose if not _is_right(a, RIGHT_TRACKED)]
    print(
        f"\nRefined from priors beside the truth: {len(attempts)} queries, "
        f"{len(attempts) - len(with_pose)} without a pose, {len(right)} within "
        f"{100 * RIGHT_TRACKED[0]:.0f} cm and {RIGHT_TRACKED[1]:.0f} degrees, {len(wrong)} not\n"
    )
    rows = []
    for name, group in (("right", right), ("wrong", wrong)):
        if group:
            agreements = np.percentile([_agreement(a) for a in group], [0, 50, 100])
            counts = (
                sum(a["converged"] for a in group),
                sum(_passes_tracking(a, settings) for a in group),
            )
            cells = [f"{agreement:.2f}" for agreement in agreements]
            rows.append([name, str(len(group)), *cells, *map(str, counts)])
    table(["", "number", "agreement: least", "median", "most", "converged", "accepted"], rows)


def plot_roc(lines: Sequence[Evidence], settings: VerificationSettings, path: Path) -> None:
    """Share of right poses accepted over share of wrong ones, as one threshold moves."""
    right, wrong = _split([line for line in lines if line["kind"] != TRACKING])
    floor = 0.5 / len(wrong)
    figure, (axes,) = new_figure(1, 8.8, 5.8)
    for criterion in CRITERIA:
        good, bad = criterion.scores(right), criterion.scores(wrong)
        thresholds = np.unique(np.concatenate([good, bad]))
        thresholds = thresholds[np.isfinite(thresholds)][::-1]
        accepted = [float(np.mean(good >= t)) for t in thresholds]
        false = [max(float(np.mean(bad >= t)), floor) for t in thresholds]
        style = "-" if criterion.more_is_better else "--"
        name = criterion.evidence.replace("_", " ")
        axes.plot(false, accepted, style, drawstyle="steps-post", label=name)
    true, untrue = (float(np.mean([_passes(a, settings) for a in s])) for s in (right, wrong))
    axes.plot([max(untrue, floor)], [true], "k*", markersize=12, label="all thresholds")
    axes.set(
        xscale="log",
        xlim=(0.9 * floor, 1.0),
        ylim=(0.5, 1.02),
        xlabel=f"wrong poses accepted (of {len(wrong)}; left edge: none)",
        ylabel=f"right poses accepted (of {len(right)})",
    )
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    save_figure(figure, path)


def _split(photos: Sequence[Evidence]) -> tuple[list[Evidence], list[Evidence]]:
    """Attempts with a right pose, and all others but those of RedKitchen without a pose."""
    right, wrong = [], []
    for photo in photos:
        for attempt in photo["attempts"]:
            if _is_right(attempt, RIGHT):
                right.append(attempt)
            elif photo["elsewhere"] or "error" in attempt:
                wrong.append(attempt)
    return right, wrong


def _is_right(attempt: Evidence, limits: tuple[float, float]) -> bool:
    if "error" not in attempt:
        return False
    return bool(attempt["error"] <= limits[0] and attempt["error_degrees"] <= limits[1])


def _passes(attempt: Evidence, settings: VerificationSettings) -> bool:
    return all(criterion.accepts(attempt, settings) for criterion in CRITERIA)


def _passes_tracking(attempt: Evidence, settings: VerificationSettings) -> bool:
    return bool(
        attempt["converged"]
        and _agreement(attempt) >= settings.min_tracking_agreement
        and attempt["overlap"] >= settings.min_overlap
        and attempt["shift"] <= _TRACKED_REACH[0]
        and attempt["shift_degrees"] <= _TRACKED_REACH[1]
        and attempt["sigma"] <= settings.max_sigma
        and attempt["sigma_degrees"] <= settings.max_sigma_degrees
    )


def _agreement(attempt: Evidence) -> float:
    value = attempt["agreement"]
    return -1.0 if value is None else float(value)
