"""Tables and the picture of tools/bench_verification.py."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.localization.verification import VerificationSettings

Evidence = Mapping[str, Any]

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
    more_is_better: bool
    logarithmic: bool

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
        if not np.isfinite(score):
            return "none"
        return f"{abs(score) if not self.more_is_better else score:.3g}"

    def middle(self, worst_right: float, best_wrong: float) -> str:
        if worst_right <= best_wrong:
            return "no gap"
        if not np.isfinite(best_wrong):
            return "any"
        if self.logarithmic:
            sign = np.sign(worst_right)
            return self.text(sign * float(np.sqrt(worst_right * best_wrong)))
        return self.text(0.5 * (worst_right + best_wrong))


CRITERIA = (
    Criterion("inliers", "min_inliers", True, True),
    Criterion("inlier_share", "min_inlier_share", True, False),
    Criterion("spread", "min_spread", True, False),
    Criterion("agreement", "min_agreement", True, False),
    Criterion("overlap", "min_overlap", True, False),
    Criterion("shift", "max_shift", False, True),
    Criterion("shift_degrees", "max_shift_degrees", False, True),
    Criterion("sigma", "max_sigma", False, True),
    Criterion("sigma_degrees", "max_sigma_degrees", False, True),
)


def print_report(photos: Sequence[Evidence], settings: VerificationSettings) -> None:
    _print_counts(photos, settings)
    _print_margins(photos, settings)
    _print_roc(*_split(photos, RIGHT), settings)
    _print_nearest(photos, settings)


def _print_margins(photos: Sequence[Evidence], settings: VerificationSettings) -> None:
    plain = _split([p for p in photos if p["kind"] == "RedKitchen"], RIGHT)
    changed = _split([p for p in photos if p["kind"].startswith("RedKitchen, ")], RIGHT)
    shuffled = _split([p for p in photos if "shuffled" in p["kind"]], RIGHT)[1]
    others = _split([p for p in photos if p["elsewhere"] and "shuffled" not in p["kind"]], RIGHT)[1]
    lost = plain[1] + changed[1]
    right, wrong = plain[0] + changed[0], others + shuffled + lost
    print(
        f"\n{len(right)} right poses (within {100 * RIGHT[0]:.0f} cm and {RIGHT[1]:.0f} degrees), "
        f"{len(wrong)} wrong ones. Worst of the right, best of the wrong:\n"
    )
    print(
        f"| evidence | threshold | right: {len(plain[0])} queries "
        f"| right: {len(changed[0])} changed | wrong: {len(others)} of elsewhere "
        f"| wrong: {len(shuffled)} shuffled "
        f"| wrong: {len(lost)} of RedKitchen | middle, queries and elsewhere | middle, all "
        "| wrong ones that only this refuses |"
    )
    print("|---" * 10 + "|")
    for criterion in CRITERIA:
        worst = [criterion.scores(g).min(initial=np.inf) for g in (plain[0], changed[0], right)]
        best = [
            criterion.scores(g).max(initial=-np.inf) for g in (others, shuffled, lost, wrong)
        ]  # fmt: skip
        rest = [c for c in CRITERIA if c is not criterion]
        cells = (
            criterion.evidence,
            getattr(settings, criterion.setting),
            *(criterion.text(score) for score in worst[:2] + best[:3]),
            criterion.middle(worst[0], best[0]),
            criterion.middle(worst[2], best[3]),
            sum(
                all(c.accepts(attempt, settings) for c in rest)
                and not criterion.accepts(attempt, settings)
                for attempt in wrong
            ),
        )
        print(f"| {' | '.join(str(cell) for cell in cells)} |")
    counts = [sum(bool(a.get("converged")) for a in group) for group in (right, wrong)]
    print(f"\nThe alignment converged for {counts[0]} of the right and {counts[1]} of the wrong.")


def _print_counts(photos: Sequence[Evidence], settings: VerificationSettings) -> None:
    rows: dict[str, Counter[str]] = {}
    for photo in photos:
        row = rows.setdefault(photo["kind"], Counter())
        row["photos"] += 1
        passed = [a for a in photo["attempts"] if _passes(a, settings)]
        best = max(passed, key=lambda attempt: attempt["agreement"], default=None)
        if best is not None:
            row["right" if _is_right(best, RIGHT) else "wrong"] += 1
    elsewhere = sum(photo["elsewhere"] for photo in photos)
    print(f"{len(photos)} photos, {elsewhere} of them of other places or of none\n")
    print("| photos | number | localized rightly | localized wrongly |")
    print("|---|---|---|---|")
    for kind, row in rows.items():
        print(f"| {kind} | {row['photos']} | {row['right']} | {row['wrong']} |")


def _print_roc(
    right: Sequence[Evidence], wrong: Sequence[Evidence], settings: VerificationSettings
) -> None:
    print(
        "\n| one criterion alone | right accepted at no wrong | at 1% | at 5% "
        "| wrong accepted at all right | at 99% | at 95% "
        "| at the threshold: right accepted | wrong accepted |"
    )
    print("|---" * 9 + "|")
    for criterion in CRITERIA:
        good = np.sort(criterion.scores(right))[::-1]
        bad = np.sort(criterion.scores(wrong))[::-1]
        accepted = [float(np.mean(good > bad[int(share * len(bad))])) for share in (0, 0.01, 0.05)]
        false = [
            float(np.mean(bad >= good[int(np.ceil(share * len(good))) - 1]))
            for share in (1, 0.99, 0.95)
        ]
        now = [float(np.mean([criterion.accepts(a, settings) for a in s])) for s in (right, wrong)]
        cells = " | ".join(f"{share:.1%}" for share in accepted + false + now)
        print(f"| {criterion.evidence} | {cells} |")
    true, false_ = (float(np.mean([_passes(a, settings) for a in s])) for s in (right, wrong))
    print(f"\nAll criteria, at the thresholds: {true:.1%} of right, {false_:.1%} of wrong poses")


def _print_nearest(photos: Sequence[Evidence], settings: VerificationSettings) -> None:
    print("\nWrong poses that came nearest, and right ones that are refused:\n")
    for photo in photos:
        for attempt in photo["attempts"]:
            right = _is_right(attempt, RIGHT)
            failed = [c for c in CRITERIA if not c.accepts(attempt, settings)]
            if failed if right else len(failed) <= 2:
                values = (
                    f"{c.evidence} {c.text(float(c.scores([attempt])[0]))}"
                    for c in failed
                )  # fmt: skip
                print(
                    f"- {'right' if right else 'wrong'}: {photo['kind']}, {photo['name']}: "
                    f"{', '.join(values) or 'passes'}{_errors(attempt)}"
                )


def print_tracking(lines: Sequence[Evidence], settings: VerificationSettings) -> None:
    """Of photos refined from a prior beside the truth, without matches."""
    attempts = [attempt for line in lines for attempt in line["attempts"]]
    with_pose = [a for a in attempts if a.get("error") is not None]
    right = [a for a in with_pose if _is_right(a, RIGHT_TRACKED)]
    wrong = [a for a in with_pose if not _is_right(a, RIGHT_TRACKED)]
    print(
        f"\nRefined from priors beside the truth: {len(attempts)} queries, "
        f"{len(attempts) - len(with_pose)} without a pose, {len(right)} within "
        f"{100 * RIGHT_TRACKED[0]:.0f} cm and {RIGHT_TRACKED[1]:.0f} degrees, {len(wrong)} not\n"
    )
    print("| | number | agreement: least | median | most | converged |")
    print("|---|---|---|---|---|---|")
    for name, group in (("right", right), ("wrong", wrong)):
        if group:
            low, middle, high = np.percentile([_agreement(a) for a in group], [0, 50, 100])
            converged = sum(a["converged"] for a in group)
            print(
                f"| {name} | {len(group)} | {low:.2f} | {middle:.2f} | {high:.2f} | {converged} |"
            )
    print("\n| agreement at least | right accepted | wrong accepted | ... that converged too |")
    print("|---|---|---|---|")
    thresholds = sorted({0.3, 0.4, 0.5, 0.55, 0.6, 0.65, 0.7, settings.min_tracking_agreement})
    for threshold in thresholds:
        counts = [
            sum(_agreement(a) >= threshold for a in right),
            sum(_agreement(a) >= threshold for a in wrong),
            sum(_agreement(a) >= threshold and a["converged"] for a in wrong),
        ]
        print(f"| {threshold} | {counts[0]} | {counts[1]} | {counts[2]} |")
    true, false = (sum(_passes_tracking(a, settings) for a in group) for group in (right, wrong))
    print(f"\nAll criteria of tracking, at the thresholds: {true} right and {false} wrong poses")
    for attempt in sorted(wrong, key=_agreement, reverse=True)[:5]:
        print(f"- wrong: agreement {_agreement(attempt):.2f}{_errors(attempt)}")


def plot_roc(photos: Sequence[Evidence], settings: VerificationSettings, path: Path) -> None:
    """Share of right poses accepted over share of wrong ones, as one threshold moves."""
    from matplotlib.figure import Figure

    right, wrong = _split(photos, RIGHT)
    floor = 0.5 / len(wrong)
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.add_subplot()
    for criterion in CRITERIA:
        good, bad = criterion.scores(right), criterion.scores(wrong)
        thresholds = np.unique(np.concatenate([good, bad]))
        thresholds = thresholds[np.isfinite(thresholds)][::-1]
        accepted = [float(np.mean(good >= t)) for t in thresholds]
        false = [max(float(np.mean(bad >= t)), floor) for t in thresholds]
        style = "-" if criterion.more_is_better else "--"
        axes.plot(
            false,
            accepted,
            style,
            drawstyle="steps-post",
            label=criterion.evidence.replace("_", " "),
        )
    true, false_ = (float(np.mean([_passes(a, settings) for a in s])) for s in (right, wrong))
    axes.plot([max(false_, floor)], [true], "k*", markersize=12, label="all thresholds")
    axes.set(
        xscale="log",
        xlim=(0.9 * floor, 1.0),
        ylim=(0.5, 1.02),
        xlabel=f"wrong poses accepted (of {len(wrong)}; left edge: none)",
        ylabel=f"right poses accepted (of {len(right)})",
    )
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _split(
    photos: Sequence[Evidence], limits: tuple[float, float]
) -> tuple[list[Evidence], list[Evidence]]:
    """Attempts with a right pose, and all others but those of RedKitchen without a pose."""
    right, wrong = [], []
    for photo in photos:
        for attempt in photo["attempts"]:
            if _is_right(attempt, limits):
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


def _errors(attempt: Evidence) -> str:
    if "error" not in attempt:
        return ""
    coarse = ""
    if "coarse_error" in attempt:
        coarse = f"; coarse {100 * attempt['coarse_error']:.1f} cm"
    error, degrees = 100 * attempt["error"], attempt["error_degrees"]
    return f" (off by {error:.1f} cm and {degrees:.2f} degrees{coarse})"
