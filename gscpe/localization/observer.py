# SPDX-License-Identifier: Apache-2.0
"""Looks on while a photo is localized."""

from __future__ import annotations

from gscpe.coarse import CoarseObserver
from gscpe.localization.attempt import Attempt
from gscpe.refinement import RefinementObserver


class Observer(CoarseObserver, RefinementObserver):
    """Is told what :meth:`gscpe.Localizer.localize` does, as it does it: the rounds of the
    coarse stage, the anchors and iterations of the refinement, and what came of each start.
    Override what you need; what is passed must not be changed."""

    def attempted(self, attempt: Attempt) -> None:
        """What came of one start."""
