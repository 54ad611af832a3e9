# SPDX-License-Identifier: Apache-2.0
"""How many may be inside at a time."""

from __future__ import annotations

import math
from contextlib import contextmanager
from typing import Callable, Iterator

from gscpe.service.problem import ProblemError, busy


class Gate:
    """Lets so many in; the others are told when to come again. For one thread.

    Args:
        most: inside at a time.
        what: that is full, for messages.
        wait: seconds until one of those inside is out, about.
    """

    def __init__(self, most: int, what: str, wait: Callable[[], float]) -> None:
        self.most = most
        self.inside = 0
        self._what, self._wait = what, wait

    @contextmanager
    def passed(self) -> Iterator[None]:
        """Whoever is inside.

        Raises:
            ProblemError: it is full.
        """
        if self.inside >= self.most:
            seconds = math.ceil(min(60.0, max(1.0, self._wait())))
            raise ProblemError(
                busy(f"{self._what} ({self.most} at a time); try again in {seconds} s", seconds)
            )
        self.inside += 1
        try:
            yield
        finally:
            self.inside -= 1
