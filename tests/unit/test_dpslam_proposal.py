"""Where particles may go: by the motion, its doubt, and what their maps see."""

import numpy as np
import pytest

from processing.dpslam.proposal import WIDE_M, WIDE_RAD, doubted, held
from processing.observability import BLIND_M
from processing.se2 import wrap


def test_what_is_known_well_is_doubted_and_what_is_wide_is_believed():
    covariance = np.diag((0.004**2, 0.3**2, 0.002**2))
    spread = np.sqrt(np.diag(doubted(covariance, 3.0)))
    assert spread == pytest.approx((0.012, 0.3, 0.006))
    # Between them the doubt ends where the deviation is wide.
    assert np.sqrt(doubted(np.diag((0.02**2, 1e-6, 1e-6)), 3.0)[0, 0]) == pytest.approx(WIDE_M)


def test_a_turn_that_is_known_roughly_is_doubted_no_more():
    # Claimed so wide already, doubted until it is so wide, and doubted in full.
    for claimed, believed in ((0.02, 0.02), (0.006, WIDE_RAD), (0.001, 0.003)):
        covariance = np.diag((1e-6, 1e-6, claimed**2))
        assert np.sqrt(doubted(covariance, 3.0)[2, 2]) == pytest.approx(believed)


def test_doubt_turns_with_the_axes():
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    covariance = np.diag((0.004**2, 0.3**2, 0.002**2))
    turned = doubted(turn @ covariance @ turn.T, 3.0)
    np.testing.assert_allclose(turned, turn @ doubted(covariance, 3.0) @ turn.T, atol=1e-12)


def information(along_m, yaw_rad):
    """Of a particle in a corridor that leads in a direction: known to along_m along, to 5 mm across."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    return turn @ np.diag((1.0 / along_m**2, 1.0 / 0.005**2, 1.0 / 0.002**2)) @ turn.T


def test_a_particle_keeps_the_motion_along_what_its_own_map_does_not_see():
    predicted = np.array(((1.0, 2.0, 0.1), (1.0, 2.0, 0.1)))
    yaw = 0.5
    along, across = np.array((np.cos(yaw), np.sin(yaw))), np.array((-np.sin(yaw), np.cos(yaw)))
    refined = predicted.copy()
    refined[:, :2] += 0.2 * along + 0.03 * across
    refined[:, 2] = wrap(refined[:, 2] + 0.02)
    poses, blind = held(
        refined, predicted, np.stack((information(2.0 * BLIND_M, yaw), information(0.01, yaw)))
    )
    assert blind.tolist() == [True, False]
    np.testing.assert_allclose(poses[0, :2], predicted[0, :2] + 0.03 * across, atol=1e-9)
    assert poses[0, 2] == refined[0, 2]
    np.testing.assert_array_equal(poses[1], refined[1])
