# SPDX-License-Identifier: Apache-2.0
"""How far a training is, and how far the next iteration takes it."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.training.settings import TrainingSettings

_WARM_UP = 3  # iterations that compile, or load what was compiled
_LARGE_COST = 2.0  # of an iteration on a whole photo, in those on a half one, until measured
_MEMORY = 0.05
_RESERVE = 0.01  # of the minutes, for what follows the last iteration


@dataclass
class Schedule:
    """Advances from share 0 to 1, by iterations or by the clock.

    By the clock, a share of the training takes that share of what time is left, at the speed
    measured last: the schedule is passed through whole, whatever the machine.

    Attributes:
        settings: of the training.
        iteration: how many are done.
        share: of the training.
        seconds: spent, all starts together.
        small_cost, large_cost: seconds of an iteration, on half and whole photos; 0 unknown.
    """

    settings: TrainingSettings
    iteration: int = 0
    share: float = 0.0
    seconds: float = 0.0
    small_cost: float = 0.0
    large_cost: float = 0.0
    _this_start: int = 0

    @property
    def is_small(self) -> bool:
        """Whether photos are half as large at the moment."""
        return self.share < self.settings.small_share

    @property
    def is_done(self) -> bool:
        return self.share >= 1.0

    def seconds_left(self) -> float:
        """An estimate."""
        if self.settings.minutes is not None:
            by_clock = 60.0 * self.settings.minutes * (1.0 - _RESERVE) - self.seconds
            return max(0.0, min(by_clock, self._cost_left() * self.settings.iterations))
        return self._cost_left() * self.settings.iterations

    def advance(self, seconds: float, cost: float) -> None:
        """After an iteration.

        Args:
            seconds: spent by now.
            cost: seconds that the iteration took.
        """
        self.seconds = seconds
        if self._this_start >= _WARM_UP:
            self._remember(cost)
        self._this_start += 1
        self.iteration += 1
        if self.settings.minutes is None:
            self.share = self.iteration / self.settings.iterations
            return
        left = 60.0 * self.settings.minutes * (1.0 - _RESERVE) - seconds
        whole = self._cost_left()
        step = 1.0 / self.settings.iterations
        if whole > 0:
            step = max(step, whole / max(left, 1e-9))
        self.share = 1.0 if left <= 0 else min(1.0, self.share + step)

    def _remember(self, cost: float) -> None:
        if self.is_small:
            before = self.small_cost or cost
            self.small_cost = before + _MEMORY * (cost - before)
        else:
            before = self.large_cost or cost
            self.large_cost = before + _MEMORY * (cost - before)

    def _cost_left(self) -> float:
        """Seconds that what is left would take, if the whole training were one iteration."""
        small = max(self.settings.small_share - self.share, 0.0)
        large = 1.0 - max(self.share, self.settings.small_share)
        large_cost = self.large_cost or _LARGE_COST * self.small_cost
        return small * self.small_cost + large * large_cost
