# SPDX-License-Identifier: Apache-2.0
"""Settings of Lucas-Kanade at one level of the pyramid."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.ranges import check_kinds, check_numbers, check_whole


@dataclass(frozen=True)
class LucasKanadeSettings:
    """Settings of the solver at one pyramid level.

    Attributes:
        max_iterations: at most (paper: 20).
        converged_pixels: a level ends when a step moves its pixels by less (RMS, pixels of
            that level).
        min_pixels: fewer usable pixels fail.
        max_template_pixels: the template is thinned to about so many, evenly: a quarter of
            a 640x480 image did as well as all of it, the strongest gradients did worse.
        min_noise: lower bound of the robust scale, luminance in [0, 1].
        gain_and_bias: solve for them; else photo and render are compared as they are.
        robust: Tukey's weights; else all residuals count alike.
        extrapolate: go on at the end by the steps that would still follow. Steps shrink by about
            the same factor each, since the anchor's gradients are not the photo's, so that a
            level may end sooner.

    Raises:
        SettingsError: a value is out of its range.
    """

    max_iterations: int = 20
    converged_pixels: float = 0.01
    min_pixels: int = 200
    max_template_pixels: int = 80_000
    min_noise: float = 1.0 / 255.0
    gain_and_bias: bool = True
    robust: bool = True
    extrapolate: bool = False

    def __post_init__(self) -> None:
        check_whole(self, "max_iterations", least=1)
        check_whole(self, "min_pixels", "max_template_pixels", least=8)
        check_numbers(self, "converged_pixels", least=0)
        check_numbers(self, "min_noise", above=0)
        check_kinds(self, gain_and_bias=bool, robust=bool, extrapolate=bool)
