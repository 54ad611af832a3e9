# SPDX-License-Identifier: Apache-2.0
"""A gain and a bias a photo and channel: what a camera's automatics do, and the splat must not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array, IntArray
from gscpe.training.parameters import Parameters

_FIRST, _SECOND = 0.9, 0.99  # a photo is seen some fifty times


@dataclass(frozen=True, eq=False)
class Exposures:
    """Of P photos; changed in place.

    Attributes:
        values: (P, 2, 3) logarithms of gains, and biases.
        first, second: (P, 2, 3) moments of Adam.
        steps: (P,) how often each was updated.
    """

    values: Float64Array
    first: Float64Array
    second: Float64Array
    steps: IntArray

    @classmethod
    def neutral(cls, photos: int) -> Exposures:
        zeros = np.zeros((photos, 2, 3))
        return cls(zeros, zeros.copy(), zeros.copy(), np.zeros(photos, dtype=np.int64))

    def update(
        self, photo: int, log_gain_gradient: Float64Array, bias_gradient: Float64Array, rate: float
    ) -> None:
        """A step of Adam for one photo."""
        gradient = np.stack([log_gain_gradient, bias_gradient])
        self.steps[photo] += 1
        count = int(self.steps[photo])
        self.first[photo] += (1.0 - _FIRST) * (gradient - self.first[photo])
        self.second[photo] += (1.0 - _SECOND) * (gradient**2 - self.second[photo])
        mean = self.first[photo] / (1.0 - _FIRST**count)
        root = np.sqrt(self.second[photo] / (1.0 - _SECOND**count))
        self.values[photo] -= rate * mean / (root + 1e-15)

    def fold_mean_into(self, parameters: Parameters) -> None:
        """Makes the mean exposure neutral; the colours take over what it was. Otherwise both
        could drift, one against the other."""
        log_gain, bias = self.values.mean(axis=0)
        self.values[:] -= self.values.mean(axis=0)
        parameters.recolour(np.exp(log_gain).astype(np.float32), bias.astype(np.float32))
