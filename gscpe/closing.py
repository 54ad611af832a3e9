# SPDX-License-Identifier: Apache-2.0
"""What holds memory, a renderer or processes until it is closed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self


class Closing(ABC):
    """Close it when it is not needed any more, or use it as a context manager."""

    @abstractmethod
    def close(self) -> None:
        """Gives back what it holds; it cannot be used after."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
