# SPDX-License-Identifier: Apache-2.0
"""Looks on while a photo is localized."""

from __future__ import annotations

from gscpe.coarse import CoarseObserver
from gscpe.localization.attempt import Attempt
from gscpe.refinement import RefinementObserver


class Observer(CoarseObserver, RefinementObserver):
    """Its methods are called at each step of :meth:`gscpe.Localizer.localize`: the rounds of the
    coarse stage, the anchors and iterations of the refinement, and what came of each start.
    Override the methods that you need; do not change their arguments. Poses, depths and covariances
    are with respect to the world, as those of the result are."""

    def attempted(self, attempt: Attempt) -> None:
        """The result of one start."""
