# SPDX-License-Identifier: Apache-2.0
"""How a splat is trained."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

from gscpe.errors import SettingsError
from gscpe.ranges import check_kinds, check_numbers, check_shares, check_whole


@dataclass(frozen=True)
class TrainingSettings:
    """Learning rates, schedule and budget. Shares are of the whole training, from 0 to 1; what
    happens at a share happens there however long the training is.

    Attributes:
        iterations: photos to learn from, one an iteration; with ``minutes``, at most so many.
        minutes: time to spend; the schedule follows the measured speed, so that the result
            depends on the machine. None: ``iterations`` exactly, and the same bytes every time.
        max_gaussians: a budget that is kept.
        sh_degree: of the colours, 0 to 3; one more at each of ``sh_shares`` until it is reached.
        antialiased: train for rendering with the opacity compensation of Mip-Splatting.
        small_share: until here photos are half as large.
        ssim_weight: loss = L1 + ssim_weight (1 - SSIM).
        position_rate: learning rate of positions, times the extent of the cameras; it falls to
            ``position_rate_end`` times it, exponentially.
        scale_rate, rotation_rate, opacity_rate, colour_rate: learning rates of the logarithms of
            the scales, quaternions, logits, and harmonics of degree 0; they fall to ``rates_end``
            times this, exponentially.
        harmonics_rate: of higher degrees, as a share of ``colour_rate``.
        exposure_rate: of gains and biases; falls to a tenth. 0 for none.
        depth_weight: so many pixels count like one point whose depth is known; it falls to
            ``depth_weight_end`` times this, exponentially. 0: depths are not looked at.
        opacity_weight, scale_weight: of the mean opacity, and of the mean scale as a share of the
            extent, in the loss: what no photo needs fades away, in place of resets.
        densify_from, densify_until: shares between which Gaussians are added.
        densify_rounds: how often.
        least_growth, most_growth: of the number of Gaussians in a round, within the budget.
        split_gradient: Gaussians whose mean gradient on the screen (a unit is half its longer
            side) is less are not split.
        prune_opacity: Gaussians fainter than this are dropped.
        prune_scale: and those larger than this share of the extent.
        prune_until: share until which they are.
        first_opacity: of the Gaussians that the points become.
        seed: of the order of the photos and of the backgrounds.

    Raises:
        SettingsError: a value is out of its range.
    """

    iterations: int = 30_000
    minutes: float | None = None
    max_gaussians: int = 250_000
    sh_degree: int = 3
    sh_shares: tuple[float, ...] = (1 / 8, 2 / 8, 3 / 8)
    antialiased: bool = False
    small_share: float = 0.6
    ssim_weight: float = 0.2
    position_rate: float = 2.5e-4
    position_rate_end: float = 0.01
    scale_rate: float = 2e-2
    rotation_rate: float = 4e-3
    opacity_rate: float = 0.05
    colour_rate: float = 2.5e-3
    rates_end: float = 0.4
    harmonics_rate: float = 0.1
    exposure_rate: float = 0.005
    depth_weight: float = 10.0
    depth_weight_end: float = 0.1
    opacity_weight: float = 0.001
    scale_weight: float = 0.01
    densify_from: float = 0.08
    densify_until: float = 0.5
    densify_rounds: int = 20
    least_growth: float = 0.05
    most_growth: float = 0.3
    split_gradient: float = 1e-4
    prune_opacity: float = 0.02
    prune_scale: float = 0.3
    prune_until: float = 0.9
    first_opacity: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        check_whole(self, "iterations", "densify_rounds", least=1)
        check_numbers(self, "minutes", above=0, below=1e5, optional=True)
        check_whole(self, "max_gaussians", least=100)
        check_whole(self, "sh_degree", least=0, most=3)
        check_whole(self, "seed", least=0)
        check_kinds(self, antialiased=bool, sh_shares=tuple)
        check_shares(self, "small_share", "densify_from", "densify_until", "prune_until")
        check_shares(self, "ssim_weight", "prune_opacity")
        check_numbers(
            self,
            "position_rate",
            "scale_rate",
            "rotation_rate",
            "opacity_rate",
            "colour_rate",
            "harmonics_rate",
            "exposure_rate",
            "depth_weight",
            "opacity_weight",
            "scale_weight",
            "least_growth",
            "most_growth",
            "split_gradient",
            least=0,
            below=1e6,
        )
        check_numbers(self, "position_rate_end", "rates_end", "depth_weight_end", above=0, most=1)
        check_numbers(self, "prune_scale", above=0, infinite=True)
        check_numbers(self, "first_opacity", above=0, below=1)
        shares = self.sh_shares
        if (
            len(shares) != 3
            or not all(isinstance(share, Real) and 0 <= share < 1e6 for share in shares)
            or list(shares) != sorted(shares)
        ):
            raise SettingsError(
                f"sh_shares must be three shares, 0 or more, in ascending order, not {shares}"
            )
        if self.least_growth > self.most_growth:
            raise SettingsError(
                "least_growth must not be above most_growth, not "
                f"{self.least_growth} and {self.most_growth}"
            )

    def sh_degree_at(self, share: float) -> int:
        """The degree of the colours at a share of the training."""
        return min(self.sh_degree, sum(share >= step for step in self.sh_shares))

    def round_at(self, share: float) -> int:
        """Rounds of densification that are due by a share of the training; those after
        ``densify_until`` only prune, and none is after ``prune_until``."""
        span = max(self.densify_until - self.densify_from, 1e-9) / self.densify_rounds
        done = (min(share, self.prune_until) - self.densify_from) / span
        return max(0, int(done + 1e-9))
