# SPDX-License-Identifier: Apache-2.0
"""Fixtures (a plugin of conftest.py): a tracker of the moving camera, and its localizer. What they
need is imported when they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Iterator

import pytest

if TYPE_CHECKING:
    from gscpe import Localizer, Tracker


@pytest.fixture(scope="module")
def localizer() -> Iterator[Localizer]:
    from moving_camera import the_map

    from gscpe import Localizer

    with Localizer(the_map(), matcher="sift") as localizer:
        yield localizer


@pytest.fixture
def tracker(localizer: Localizer) -> Iterator[Tracker]:
    from moving_camera import WAITS

    from gscpe import Tracker

    with Tracker(localizer, WAITS) as tracker:
        yield tracker
