# SPDX-License-Identifier: Apache-2.0
"""What a tracker says of a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from gscpe.arrays import Float64Array, short_repr

TrackingStatus = Literal["tracking", "relocalized", "lost"]


@dataclass(frozen=True, eq=False)
class TrackingResult:
    """Where the camera was when it took a frame, or why that is not known.

    Attributes:
        status: ``"tracking"``: followed from the frame before; ``"relocalized"``: found, after it
            had been lost or for the first time; ``"lost"``: not known.
        reason: why it is lost, or None.
        cam_from_world: (4, 4) float64, world to camera; None when lost.
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``, (translation, rotation), world
            units and radians: the first three describe the camera's centre, along the camera's
            axes (docs/tracking.md: for filters). None when lost.
        anchor_age: frames since the render that this frame was aligned with was asked for; None
            when lost.
        agreement: correlation of that render and the frame, in [-1, 1]; NaN when there is nothing
            to compare.
        milliseconds: that the call took.
    """

    status: TrackingStatus
    reason: str | None
    cam_from_world: Float64Array | None
    covariance: Float64Array | None
    anchor_age: int | None
    agreement: float
    milliseconds: float

    def __repr__(self) -> str:
        return short_repr(self)

    def within(self, milliseconds: float) -> TrackingResult:
        """The same answer, with the time that it took."""
        return replace(self, milliseconds=milliseconds)

    def because(self, cause: str | None) -> TrackingResult:
        """The same answer, its reason followed by another, if there is one."""
        if cause is None or self.reason is None or cause == self.reason:
            return self
        return replace(self, reason=f"{self.reason}; {cause}")


def lost(reason: str) -> TrackingResult:
    """A frame without a pose."""
    return TrackingResult("lost", reason, None, None, None, float("nan"), 0.0)
