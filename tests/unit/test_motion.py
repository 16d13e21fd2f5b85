"""Uncertainty travels with the pose: checked against what a small error really does."""

import numpy as np
import pytest

from processing.motion import Motion, carried, following
from processing.se2 import between, compose


@pytest.mark.parametrize("motion", [(1.0, 0.0, 0.0), (0.4, -0.3, 1.2), (-2.0, 0.7, -2.9)])
def test_a_small_error_arrives_where_the_covariance_says(motion):
    old_t_new = np.array(motion)
    rng = np.random.default_rng(1)
    spread = rng.normal(size=(3, 3)) * 1e-3
    covariance = spread @ spread.T
    errors = rng.multivariate_normal(np.zeros(3), covariance, 20000)
    arrived = between(
        np.tile(old_t_new, (len(errors), 1)), compose(errors, np.tile(old_t_new, (len(errors), 1)))
    )
    np.testing.assert_allclose(
        carried(covariance, old_t_new), np.cov(arrived.T), atol=0.05 * np.abs(np.cov(arrived.T)).max()
    )


def test_leaving_a_scan_out_adds_up_what_was_not_known():
    def motion(x, variance):
        return Motion(7, np.array((x, 0.0, 0.0)), np.diag((variance, variance, 0.0)), np.zeros(3))

    both = following(motion(1.0, 1e-4), motion(1.5, 2e-4))
    np.testing.assert_allclose(both.covariance, np.diag((3e-4, 3e-4, 0.0)))
    np.testing.assert_array_equal(both.odom_t_laser, (1.5, 0.0, 0.0))
