# SPDX-License-Identifier: Apache-2.0
"""Where the camera will be in the next frame: its velocity stays, or somebody has measured it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gscpe.arrays import Float64Array, short_repr
from gscpe.errors import PoseError
from gscpe.geometry import se3
from gscpe.geometry.se3 import check_transform

_CALM = 0.5
"""Weight of the last surprise in their running mean square."""
_FIRST_SURPRISE = 8.0
"""Pixels, of a camera whose velocity is not known yet."""
_LEAST_SURPRISE = 0.5


@dataclass(frozen=True, eq=False)
class Motion:
    """How the camera moved between the last frame and this one, as odometry or an IMU measures it.

    Attributes:
        cam_from_previous_cam: (4, 4), the last frame's camera coordinates in this one's; its
            translation is in world units. It is copied, and the copy cannot be changed.
        translation_sigma: standard deviation along each axis, world units.
        rotation_sigma: standard deviation of the rotation about each axis, degrees.

    Raises:
        PoseError: the motion is not a rigid transform, or a deviation is not a positive number.
    """

    cam_from_previous_cam: Float64Array
    translation_sigma: float = 0.01
    rotation_sigma: float = 0.5

    def __post_init__(self) -> None:
        moved = check_transform(self.cam_from_previous_cam, "cam_from_previous_cam")
        moved = se3.nearest_rigid(moved)
        moved.setflags(write=False)
        object.__setattr__(self, "cam_from_previous_cam", moved)
        for name in ("translation_sigma", "rotation_sigma"):
            sigma = getattr(self, name)
            try:
                number = float(sigma)
            except (TypeError, ValueError):
                number = np.nan
            if not 0 < number < np.inf:
                raise PoseError(f"a motion's {name} must be a positive number, not {sigma!r}")
            object.__setattr__(self, name, number)

    def __repr__(self) -> str:
        return short_repr(self)

    def sigmas(self) -> Float64Array:
        """(6,) of its tangent vector."""
        return np.repeat([self.translation_sigma, np.radians(self.rotation_sigma)], 3)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Where a frame's camera is expected.

    Attributes:
        cam_from_world: (4, 4).
        surprise_pixels: by how much the image may be elsewhere, root mean square, as experience
            says; it does not count what ``sigmas`` say.
        sigmas: (6,) standard deviations of xi in ``exp(xi) @ cam_from_world`` from measured
            motions.
    """

    cam_from_world: Float64Array
    surprise_pixels: float
    sigmas: Float64Array

    def pixels(self, motion: Float64Array) -> float:
        """By how much the image may be elsewhere, all in all.

        Args:
            motion: (6, 6), see :class:`gscpe.refinement.template.Template`.
        """
        measured = float(np.sum(np.diag(motion) * self.sigmas**2))
        return float(np.sqrt(self.surprise_pixels**2 + measured))


@dataclass(frozen=True, eq=False)
class MotionState:
    """What is known of the camera's motion after a frame.

    Attributes:
        cam_from_world: (4, 4), at that frame: measured, or expected if nothing was seen.
        time: of the frame.
        velocity: (6,) xi per unit of time, ``exp(velocity * dt) @ cam_from_world``.
        surprise_pixels: root of the running mean square of how far the image was from where it
            was expected.
        sigmas: (6,) of measured motions since a pose was last seen.
        unseen: frames since then.
    """

    cam_from_world: Float64Array
    time: float
    velocity: Float64Array
    surprise_pixels: float
    sigmas: Float64Array
    unseen: int = 0

    @classmethod
    def at_rest(cls, cam_from_world: Float64Array, time: float) -> MotionState:
        """A camera whose velocity is not known."""
        return cls(cam_from_world, time, np.zeros(6), _FIRST_SURPRISE, np.zeros(6))

    def predicted(self, time: float, motion: Motion | None = None) -> Prediction:
        """The next frame: by the measured motion if there is one, else at constant velocity."""
        if motion is not None:
            sigmas = np.hypot(self.sigmas, motion.sigmas())
            return Prediction(
                se3.nearest_rigid(motion.cam_from_previous_cam @ self.cam_from_world),
                0.0 if self.unseen == 0 else self.surprise_pixels,
                sigmas,
            )
        step = self.velocity * (time - self.time)
        # What may have changed since the last frame that was seen grows with the time.
        surprise = self.surprise_pixels * (1.0 + self.unseen)
        pose = se3.nearest_rigid(se3.exp(step) @ self.cam_from_world)
        return Prediction(pose, surprise, self.sigmas)

    def seen(
        self, cam_from_world: Float64Array, time: float, surprise_pixels: float
    ) -> MotionState:
        """The state after a frame whose pose was found, so many pixels from where it was
        expected."""
        elapsed = time - self.time
        step = se3.log(cam_from_world @ se3.inverse(self.cam_from_world))
        square = (1.0 - _CALM) * self.surprise_pixels**2 + _CALM * surprise_pixels**2
        return MotionState(
            cam_from_world,
            time,
            # After frames that were not seen, the last pose is where the camera was expected.
            self.velocity if self.unseen else step / elapsed,
            max(float(np.sqrt(square)), _LEAST_SURPRISE, 0.7 * surprise_pixels),
            np.zeros(6),
        )

    def not_seen(self, time: float, motion: Motion | None = None) -> MotionState:
        """The state after a frame that showed nothing."""
        expected = self.predicted(time, motion)
        return replace(
            self,
            cam_from_world=expected.cam_from_world,
            time=time,
            sigmas=expected.sigmas,
            unseen=self.unseen + 1,
        )
