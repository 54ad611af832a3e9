# SPDX-License-Identifier: Apache-2.0
"""Covariances of information that may be singular."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gscpe.geometry.information import covariance_from_information


@given(st.integers(0, 2**32 - 1))
def test_regular_information_is_inverted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-2, 4, 6)
    jacobian = rng.normal(size=(30, 6)) * scale
    information = jacobian.T @ jacobian
    covariance = covariance_from_information(information)
    np.testing.assert_allclose(information @ covariance, np.eye(6), atol=1e-6)


def test_what_is_not_observed_has_a_large_variance() -> None:
    jacobian = np.zeros((20, 6))
    jacobian[:, :5] = np.random.default_rng(0).normal(size=(20, 5))
    jacobian[:, 4] = jacobian[:, 3]  # only their sum is observed
    covariance = covariance_from_information(jacobian.T @ jacobian)
    known = covariance[0, 0]
    assert covariance[5, 5] > 1e6 * known
    difference = np.array([0, 0, 0, 1, -1, 0]) / np.sqrt(2)
    assert difference @ covariance @ difference > 1e6 * known
    together = np.abs(difference)
    assert together @ covariance @ together < 100 * known


def test_no_information_at_all_is_not_certainty() -> None:
    covariance = covariance_from_information(np.zeros((6, 6)))
    assert np.all(np.isfinite(covariance))
    assert np.all(np.diag(covariance) > 1e6)
