"""What adds up along a way is what was not seen, and a bend that far points would have shown."""

import numpy as np
import pytest

from processing.dpslam.drift import MOST_VARIANCE, STEADYING_M, drift_of
from processing.dpslam.loop_config import LoopConfig

AHEAD = np.array((0.25, 0.0, 0.0))


def around(radius_m):
    """Points all around at one distance."""
    bearings = np.linspace(-np.pi, np.pi, 60)
    return radius_m * np.column_stack((np.cos(bearings), np.sin(bearings)))


def deviations(covariance, points, motion=AHEAD):
    return np.sqrt(np.diag(drift_of(covariance, motion, points, LoopConfig())))


def test_where_nothing_is_claimed_the_least_drift_of_any_matcher_is_left():
    x, y, yaw = deviations(np.zeros((3, 3)), around(1.0))
    assert x == y == pytest.approx(0.01 * 0.25 + 0.003)
    assert yaw == pytest.approx(0.004 * 0.25 + 0.001)


def test_what_was_seen_does_not_add_up_and_what_was_not_does():
    floor = deviations(np.zeros((3, 3)), around(1.0))
    seen = deviations(np.diag((0.01**2, 0.01**2, 0.003**2)), around(1.0))
    np.testing.assert_allclose(seen, floor, rtol=0.25)
    # A corridor at 45 degrees, along which nothing was seen.
    along, across = np.array((1.0, 1.0)) / np.sqrt(2.0), np.array((1.0, -1.0)) / np.sqrt(2.0)
    claimed = np.zeros((3, 3))
    claimed[:2, :2] = 0.3**2 * np.outer(along, along) + 0.01**2 * np.outer(across, across)
    drift = drift_of(claimed, AHEAD, around(1.0), LoopConfig())[:2, :2]
    assert np.sqrt(along @ drift @ along) == pytest.approx(0.3, rel=0.02)
    assert np.sqrt(across @ drift @ across) == pytest.approx(floor[0], rel=0.2)
    assert deviations(np.diag((0.0, 0.0, 0.2**2)), around(1.0))[2] == pytest.approx(0.2, rel=0.02)


def test_far_points_hold_the_heading():
    near, far, none = (
        deviations(np.zeros((3, 3)), points)[2] for points in (around(1.0), around(20.0), np.zeros((0, 2)))
    )
    assert far == pytest.approx((0.01 * 0.25 + 0.003) / STEADYING_M)
    assert near == none > 1.5 * far
    # A turn is known to a share of itself, whatever is in sight.
    turned = deviations(np.zeros((3, 3)), around(20.0), np.array((0.0, 0.0, 0.5)))[2]
    assert turned == pytest.approx(0.003 / STEADYING_M + 0.004 * 0.5)


def test_a_motion_of_which_nothing_is_known_does_not_open_the_whole_world():
    assert (deviations(np.diag((1e6, 1e6, 1e6)), around(1.0)) < 1.01 * np.sqrt(MOST_VARIANCE)).all()


@pytest.mark.parametrize("bearing_rad", [0.0, 0.5, np.pi / 4, 2.0])
def test_a_motion_that_is_wide_open_along_a_slanting_corridor_is_known_across_it(bearing_rad):
    along = np.array((np.cos(bearing_rad), np.sin(bearing_rad)))
    across = np.array((-along[1], along[0]))
    claimed = np.zeros((3, 3))
    claimed[:2, :2] = 5.0**2 * np.outer(along, along) + 0.01**2 * np.outer(across, across)
    drift = drift_of(claimed, AHEAD, around(1.0), LoopConfig())
    assert np.linalg.eigvalsh(drift).min() > 0.0
    assert along @ drift[:2, :2] @ along == pytest.approx(MOST_VARIANCE, rel=0.01)
    assert np.sqrt(across @ drift[:2, :2] @ across) < 0.01
