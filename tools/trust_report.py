# SPDX-License-Identifier: Apache-2.0
"""Tables of tools/bench_trust.py."""

from __future__ import annotations

from collections import Counter
from typing import Any, Iterable, Iterator, Mapping, Sequence

import numpy as np
from _common import share, table
from scipy.stats import chi2

from gscpe.localization import VerificationSettings

Line = Mapping[str, Any]
"""One photo in one map, as tools/bench_trust.py measured it."""

RIGHT = (0.05, 5.0)
"""Metres, for surfaces two metres away, and degrees within which a pose is right."""
STAGES = ("coarse", "aligned", "final")
_MATCHES = {"inliers": "min_inliers", "inlier_share": "min_inlier_share", "spread": "min_spread"}
_DEGREES_OF_FREEDOM = 6


def print_report(maps: Sequence[str], lines: Sequence[Line]) -> None:
    """In Markdown.

    Args:
        maps: names of the places with a map.
        lines: photos in them.
    """
    own = [line for line in lines if line["map"] == line["place"]]
    foreign = [line for line in lines if line["map"] != line["place"]]
    _print_counts(maps, own, foreign)
    _print_foreign(foreign)
    _print_roc(maps, own, foreign)
    _print_normalized_errors(maps, own)
    _print_chain(own)


def is_right(line: Line) -> bool:
    """Whether a localized photo of the map's own place is where it was taken."""
    final = line["stages"]["final"]
    return bool(final["error"] * line["unit"] <= RIGHT[0] and final["degrees"] <= RIGHT[1])


def margin(attempt: Mapping[str, Any], settings: VerificationSettings) -> float:
    """By how much all thresholds on matches could be multiplied for the attempt to pass them."""
    return min(
        float(attempt.get(evidence, 0.0)) / float(getattr(settings, threshold))
        for evidence, threshold in _MATCHES.items()
    )


def best_margin(line: Line, settings: VerificationSettings) -> float:
    """The best of everything that was tried."""
    return max((margin(attempt, settings) for attempt in line["attempts"]), default=0.0)


def area_under_roc(right: Sequence[float], wrong: Sequence[float]) -> float:
    """Probability that a right one scores higher than a wrong one; draws count half."""
    difference = np.subtract.outer(np.asarray(right), np.asarray(wrong))
    return float(np.mean((difference > 0) + 0.5 * (difference == 0)))


def normalized_errors(lines: Iterable[Line], stage: str) -> list[float]:
    """``xi^T C^-1 xi`` of the localized photos; averages 6 where covariances are right."""
    found = (line["stages"][stage] for line in lines if line["localized"])
    return [float(np.dot(s["xi"], np.linalg.solve(s["covariance"], s["xi"]))) for s in found]


def _of(lines: Iterable[Line], name: str, camera: str | None = None) -> list[Line]:
    return [x for x in lines if x["map"] == name and camera in (None, x["camera"])]


def _print_counts(maps: Sequence[str], own: Sequence[Line], foreign: Sequence[Line]) -> None:
    limit = f"{100 * RIGHT[0]:.0f} cm, {RIGHT[1]:.0f}°"
    print(f"Wrong: more than {limit} off (lengths for surfaces 2 m away)\n")
    rows = []
    for name in maps:
        cells = [name]
        for camera in ("given", "estimated"):
            photos = _of(own, name, camera)
            found = [line for line in photos if line["localized"]]
            wrong = sum(not is_right(line) for line in found)
            cells += [f"{len(found)} of {len(photos)}", str(wrong)]
        others = _of(foreign, name)
        cells.append(f"{sum(line['localized'] for line in others)} of {len(others)}")
        rows.append(cells)
    table(
        ["map", "localized", "wrong", "localized, cameras estimated", "wrong", "other places"],
        rows,
    )
    counts = [f"{sum(x['localized'] for x in some)} of {len(some)}" for some in (foreign, own)]
    print(f"\nIn all: {counts[0]} photos of other places localized, {counts[1]} of the map's own")


def _print_foreign(foreign: Sequence[Line]) -> None:
    for line in foreign:
        if line["localized"]:
            print(f"\n{line['name']} of {line['place']} is localized in {line['map']}: "
                  f"{_shown(line['attempts'][line['best']])}")  # fmt: skip


def _shown(attempt: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in attempt.items()
        if value is not None
    )


def _print_roc(maps: Sequence[str], own: Sequence[Line], foreign: Sequence[Line]) -> None:
    settings = VerificationSettings()
    print(
        "\nMatches, of the best attempt: by how much all thresholds on them could be multiplied\n"
    )
    rows = []
    for name in (*maps, None):
        right, wrong = (
            [best_margin(x, settings) for x in lines if name in (None, x["map"])]
            for lines in ((x for x in own if x["camera"] == "given"), foreign)
        )
        if right and wrong:
            lowest = np.percentile(right, [0.0, 3.0, 50.0])
            rows.append([
                name or "all",
                f"{area_under_roc(right, wrong):.5f}",
                *(f"{value:.2f}" for value in lowest),
                f"{max(wrong):.2f}",
                share([value >= max(wrong) for value in right]),
            ])  # fmt: skip
    table(
        ["map", "area under ROC", "right: least", "right: 3%", "right: median",
         "other places: most", "right ones above the most of other places"],
        rows,
    )  # fmt: skip
    _print_doubts(foreign)


def _print_doubts(foreign: Sequence[Line]) -> None:
    """What stopped attempts whose matches were good enough."""
    reached = [a for line in foreign for a in line["attempts"] if "agreement" in a]
    print(f"\n{sum(len(x['attempts']) for x in foreign)} attempts with photos of other places; "
          f"{len(reached)} came to the alignment")  # fmt: skip
    for attempt in reached:
        print(f"- {_shown(attempt)}")


def _print_normalized_errors(maps: Sequence[str], own: Sequence[Line]) -> None:
    print("\nNormalized errors squared (6 if covariances are right)\n")
    limit = float(chi2(_DEGREES_OF_FREEDOM).ppf(0.95))
    rows = []
    for name in maps:
        for camera in ("given", "estimated"):
            found = [line for line in _of(own, name, camera) if line["localized"]]
            rows += list(_normalized_rows(f"{name}, cameras {camera}", found, limit))
    table(
        ["", "photos", "mean", "mean of the lower 95%", "median", "below 95% limit", "position",
         "rotation", "median error"],
        rows,
    )  # fmt: skip


def _normalized_rows(name: str, found: Sequence[Line], limit: float) -> Iterator[list[str]]:
    for stage in STAGES if found else ():
        values = np.sort(normalized_errors(found, stage))
        kept = values[: int(np.ceil(0.95 * len(values)))]
        errors = [line["stages"][stage] for line in found]
        turns = [s["degrees"] for s in errors]
        lengths = [s["error"] * line["unit"] for s, line in zip(errors, found, strict=True)]
        yield [
            f"{name}, {stage}",
            str(len(found)),
            f"{values.mean():.2f}",
            f"{kept.mean():.2f}",
            f"{np.median(values):.2f}",
            share([bool(value <= limit) for value in values]),
            *(f"{_of_half(errors, half):.2f}" for half in (slice(0, 3), slice(3, 6))),
            f"{1000 * np.median(lengths):.3f} mm / {np.median(turns):.4f}°",
        ]


def _of_half(errors: Sequence[Mapping[str, Any]], half: slice) -> float:
    """The median of the normalized error squared of the position or the rotation alone, times
    two, so that it stands beside that of both."""
    values = []
    for stage in errors:
        xi, covariance = np.array(stage["xi"])[half], np.array(stage["covariance"])[half, half]
        values.append(xi @ np.linalg.solve(covariance, xi))
    return 2.0 * float(np.median(values))


def _print_chain(own: Sequence[Line]) -> None:
    """What found the photos: most are found by what is tried first."""
    counts = Counter(
        (line["map"], attempt["matcher"], attempt["orientation"])
        for line in own
        if line["localized"]
        for attempt in [line["attempts"][line["best"]]]
    )
    print("\nWhat found them\n")
    table(
        ["map", "matcher", "orientation", "photos"],
        ([name, str(matcher), str(turn), str(n)] for (name, matcher, turn), n in counts.items()),
    )
    for line in own:
        if not line["localized"]:
            print(f"\nNot localized: {line['name']} of {line['map']}, camera {line['camera']}: "
                  f"{line['reason']}")  # fmt: skip
        elif not is_right(line):
            error = line["stages"]["final"]
            print(f"\nWrong: {line['name']} of {line['map']}, camera {line['camera']}, "
                  f"{error['error'] * line['unit']:.3f} m, {error['degrees']:.2f}°: "
                  f"{_shown(line['attempts'][line['best']])}")  # fmt: skip
