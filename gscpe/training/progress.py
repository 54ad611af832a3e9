# SPDX-License-Identifier: Apache-2.0
"""What a training tells while it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, TypeAlias

from tqdm import tqdm


@dataclass(frozen=True)
class Progress:
    """Where a training is.

    Attributes:
        iteration: how many are done.
        share: of the training, 0 to 1.
        gaussians: their number.
        psnr: of the photos seen last, exposure fitted, dB.
        seconds_left: an estimate.
    """

    iteration: int
    share: float
    gaussians: int
    psnr: float
    seconds_left: float


Listener: TypeAlias = Callable[[Progress], None]


class ProgressBar:
    """Shows it in the terminal; call it with what is new, and close it."""

    def __init__(self) -> None:
        self._bar: Any = tqdm(
            total=1000, bar_format="{desc} |{bar}| {percentage:3.0f}%{postfix}", desc="training"
        )

    def __call__(self, progress: Progress) -> None:
        minutes, seconds = divmod(round(progress.seconds_left), 60)
        self._bar.set_postfix_str(
            f"PSNR {progress.psnr:.2f} dB, {progress.gaussians} Gaussians, "
            f"iteration {progress.iteration}, {minutes}:{seconds:02d} left",
            refresh=False,
        )
        self._bar.update(int(1000 * progress.share) - self._bar.n)

    def close(self) -> None:
        self._bar.close()
